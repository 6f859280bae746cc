"""The prose of the reports, kept in ``templates/prose.md``."""

import functools
import re
from importlib import resources
from typing import Any

from epiprior_lab.report.page import Picture


@functools.cache
def _texts() -> dict[str, str]:
    text = (resources.files("epiprior_lab.report") / "templates" / "prose.md").read_text(encoding="utf-8")
    found: dict[str, str] = {}
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        name, _, body = part.partition("\n")
        # A line that neither follows an empty one nor starts an item belongs to the line before it.
        found[name] = re.sub(r"(?<!\n)\n(?!\n|- )", " ", body.strip())
    return found


def say(name: str, **values: Any) -> str:
    """Return a text as Markdown, a line per paragraph or item, with `values` in the place of names in braces."""
    return _texts()[name].format(**values)


def picture(name: str, path: str, **values: Any) -> Picture:
    """Return a picture with its text and caption."""
    alt, _, caption = say(f"figure {name}", **values).partition("\n\n")
    return Picture(path=path, alt=alt, caption=caption)
