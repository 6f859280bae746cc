"""The result tables of the README, made of the committed reports.

A table stands between ``<!-- results:NAME -->`` and ``<!-- /results -->``; everything else is left alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from epiprior.errors import EpipriorError
from epiprior_lab.params import PHOTOGRAPHS, load_params
from epiprior_lab.report.markdown import bounds_lines, duel_lines, markdown_table, successes_lines
from epiprior_lab.report.photographs.wording import bound_rows, set_lines, split_lines, time_lines
from epiprior_lab.report.study import read_table

_SECTION = re.compile(r"(<!-- results:(\S+) -->\n)(.*?)(<!-- /results -->)", re.DOTALL)
_OPENING = re.compile(r"<!-- results:")
_PERFORMANCE = "threshold_px family estimator pairs without snn default default_over_without"
_DUEL = "threshold_px family input estimator difference difference_low difference_high verdict"
_BOUNDS = "kind family threshold_px input estimator wanted found low high possible beaten others met"
_REAL = Path("reports/real/tables")
_REAL_SUCCESSES = "threshold_px group estimator input pairs successes scene_share gain gain_low gain_high"
_REAL_BOUNDS = "kind group threshold_px estimator against wanted found low high scene_found possible kept of met"
_TIMINGS = Path("reports/real/timings")


class ReadmeError(EpipriorError):
    """The README has a marker without an end, or asks for a table that there is not."""


def update_readme(root: Path) -> bool:
    """Write the tables of the reports into ``README.md``.

    Parameters
    ----------
    root : Path
        Root of the repository.

    Returns
    -------
    bool
        Whether the file changed.

    Raises
    ------
    ReadmeError
        If a marker names no table or has no end.
    ReportError
        If a report is missing or lacks a column.
    """
    path = root / "README.md"
    before = path.read_text(encoding="utf-8")
    after = render_readme(before, root)
    if after != before:
        path.write_text(after, encoding="utf-8", newline="\n")
    return after != before


def render_readme(text: str, root: Path) -> str:
    """Return a text with every table between markers made anew; see `update_readme`."""
    if len(_OPENING.findall(text)) != len(_SECTION.findall(text)):
        raise ReadmeError("README: a marker `<!-- results:NAME -->` has no `<!-- /results -->` behind it")

    def table(match: re.Match[str]) -> str:
        name = match[2]
        if name not in TABLES:
            raise ReadmeError(f"README: no table {name!r}, there are {', '.join(TABLES)}")
        return match[1] + "\n".join(TABLES[name](root)) + "\n" + match[4]

    return _SECTION.sub(table, text)


def _successes(root: Path) -> list[str]:
    table = read_table(root / "reports" / "performance.csv", _PERFORMANCE)
    return successes_lines(table, load_params(root / "params.yaml").report.success_px)


def _duel(root: Path) -> list[str]:
    report = load_params(root / "params.yaml").report
    table = read_table(root / "reports" / "duel.csv", _DUEL)
    return duel_lines(table, report.success_px, report.hard_groups)


def _bounds(root: Path) -> list[str]:
    champion = load_params(root / "params.yaml").report.champion
    return bounds_lines(read_table(root / "reports" / "bounds.csv", _BOUNDS), champion)


def _photographs(root: Path) -> list[str]:
    """Return the successes on photographs: per split and estimator, then per set of the gallery's estimator."""
    tables, report = root / _REAL, load_params(root / PHOTOGRAPHS).report
    successes = read_table(tables / "successes.csv", _REAL_SUCCESSES)
    rankings = read_table(tables / "rankings.csv", "group ranking precision_100")
    sets = read_table(tables / "sets.csv", "set title state pairs").fillna({"state": ""})
    strict = 3.0 if 3.0 in report.thresholds_px else min(report.thresholds_px)
    shown = report.gallery.estimator
    return [
        *split_lines(successes, report.success_px),
        "",
        f"{shown}, per set: precision of the top 100 / successes below {report.success_px:g} px / below {strict:g} px.",
        "",
        *set_lines(sets, successes, rankings, shown, (report.success_px, strict)),
    ]


def _photographs_bounds(root: Path) -> list[str]:
    bounds = read_table(root / _REAL / "bounds.csv", _REAL_BOUNDS)
    rows = [[row["bound"], row["found"], row["met"]] for row in bound_rows(bounds)]
    return markdown_table(["bound", "found", "met"], rows, texts=3)


def _photographs_time(root: Path) -> list[str]:
    at = root / _TIMINGS
    return time_lines(
        read_table(at / "bounds.csv", "bound wanted found met"),
        read_table(at / "overhead.csv", "estimator seconds_without seconds_with seconds_cascade preprocessed"),
        read_table(at / "pairs.csv", "set pair_id estimator seconds_without seconds_with seconds_cascade"),
    )


TABLES: Mapping[str, Callable[[Path], list[str]]] = {
    "successes": _successes,
    "duel": _duel,
    "bounds": _bounds,
    "photographs": _photographs,
    "photographs-bounds": _photographs_bounds,
    "photographs-time": _photographs_time,
}
