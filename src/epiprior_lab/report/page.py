"""A page is built once, as sections of prose, tables and figures, and rendered as Markdown and as HTML.

Its prose is kept in ``templates/prose.yaml``.
"""

import functools
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import yaml
from markdown_it import MarkdownIt
from markupsafe import Markup

import epiprior


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of texts; cells may hold Markdown, and a row of a single cell is a heading for the rows below it.

    So many columns in front are `texts`, others numbers. The HTML folds the table under the title `fold`, if any.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1
    fold: str = ""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture beside the page: its `path` relative to the page, a text in its place, and a caption."""

    path: str
    alt: str
    caption: str = ""


Block = str | Table | Picture | tuple[Picture, ...]  # prose is Markdown; pictures of a tuple stand side by side


@dataclass(frozen=True, kw_only=True)
class Page:
    """A title, what the page is about (Markdown), and sections by their titles."""

    title: str
    about: str
    sections: Mapping[str, Sequence[Block]]

    @property
    def shown(self) -> dict[str, list[Block]]:
        """The sections without tables that have no rows, but for those where nothing but prose is left."""
        kept = {
            title: [block for block in blocks if block and not (isinstance(block, Table) and not block.rows)]
            for title, blocks in self.sections.items()
        }
        return {title: own for title, own in kept.items() if not all(isinstance(block, str) for block in own)}

    def write(self, folder: Path, *, markdown: str = "performance.md", html: str = "index.html") -> None:
        """Write both files; an empty name leaves one out."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, render in ((markdown, render_markdown), (html, render_html)):
            if name:
                (folder / name).write_text(render(self), encoding="utf-8", newline="\n")


@functools.cache
def _texts() -> dict[str, str]:
    file = resources.files("epiprior_lab.report") / "templates" / "prose.yaml"
    found: dict[str, str] = yaml.safe_load(file.read_text(encoding="utf-8"))
    return found


def say(name: str, **values: Any) -> str:
    """Return a text as Markdown, a line per paragraph or item, with `values` in the place of names in braces."""
    return _texts()[name].format(**values)


def picture(name: str, path: str, **values: Any) -> Picture:
    """Return a picture with its text and caption."""
    caption = _texts().get(f"caption {name}", "").format(**values)
    return Picture(path=path, alt=say(f"alt {name}"), caption=caption)


def table_lines(table: Table) -> list[str]:
    """Return a table as lines of Markdown."""
    width = len(table.head)
    rule = "|" + "---|" * table.texts + "---:|" * (width - table.texts)
    rows = ([f"**{row[0]}**", *[""] * (width - 1)] if len(row) == 1 else row for row in table.rows)
    head, *texts = ("| " + " | ".join(row) + " |" for row in (table.head, *rows))
    return [head, rule, *texts]


def render_markdown(page: Page) -> str:
    """Return a page as Markdown."""
    lines = [f"# {page.title}", "", *_prose(page.about)]
    for title, blocks in page.shown.items():
        lines += ["", f"## {title}"]
        for block in blocks:
            if isinstance(block, Table):
                lines += ["", *([f"### {block.fold}", ""] if block.fold else []), *table_lines(block)]
            elif isinstance(block, str):
                lines += ["", *_prose(block)]
            else:
                for picture in block if isinstance(block, tuple) else (block,):
                    lines += ["", f"![{picture.alt}]({picture.path})"]
                    lines += ["", *_prose(picture.caption)] if picture.caption else []
    return "\n".join(lines) + "\n"


def _prose(text: str) -> list[str]:
    """Return paragraphs and lists with lines of at most 110 characters."""
    how: Any = {"break_long_words": False, "break_on_hyphens": False}
    lines: list[str] = []
    for line in text.splitlines():
        lines += textwrap.wrap(line, 110, subsequent_indent="  " if line.startswith("- ") else "", **how) or [""]
    return lines


def render_html(page: Page) -> str:
    """Return a page as HTML, all of it in one file but for the pictures."""
    reader = MarkdownIt("commonmark", {"html": False})
    loader = jinja2.PackageLoader("epiprior_lab.report")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = environment.keep_trailing_newline = True
    environment.filters["inline"] = lambda text: Markup(reader.renderInline(text))
    environment.filters["anchor"] = lambda title: re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
    environment.filters["prose"] = lambda text: Markup(reader.render(text))
    template = environment.get_template("page.html.j2")
    return template.render(page=page, sections=page.shown.items(), version=epiprior.__version__)
