"""The tables of results in the README, made of the committed reports on photographs and on bags of them.

They stand between ``<!-- results -->`` and ``<!-- /results -->``, ``<!-- sfm -->`` and ``<!-- /sfm -->``. Everything
else is left alone, and so is the second where bags were not measured.
"""

import re
from pathlib import Path
from typing import Any

from epiprior.errors import EpipriorError
from epiprior_lab.bags.params import PATH as BAGS
from epiprior_lab.bags.params import load_sfm_params
from epiprior_lab.evaluation.records import read_table
from epiprior_lab.params import PHOTOGRAPHS, load_params
from epiprior_lab.report.bags import small_table
from epiprior_lab.report.material import summary_table
from epiprior_lab.report.page import Table, table_lines
from epiprior_lab.report.text import ALL

TABLES = Path("reports/real/tables")
TIMES = Path("reports/real/timings/pairs.csv")
BAG_TABLES = Path("reports/sfm/tables")


class ReadmeError(EpipriorError):
    """The README has not exactly one place for a table."""


def render_readme(text: str, root: Path) -> str:
    """Return a text with the tables between the markers made anew, of the reports below `root`.

    A ReadmeError says that there is not exactly one place for one, a TableError that the report lacks something.
    """
    report = load_params(root / PHOTOGRAPHS).report
    columns = "threshold_px group estimator pairs"
    successes = read_table(root / TABLES / "successes.csv", f"{columns} input successes")
    cascade = read_table(root / TABLES / "cascade.csv", f"{columns} cascade")
    rankings = read_table(root / TABLES / "rankings.csv", "group")
    px = (report.success_px, report.strict_px)
    timed = read_table(root / TIMES, "input estimator seconds_total")
    seconds: dict[Any, float] = timed.groupby(["input", "estimator"])["seconds_total"].mean().to_dict()
    small = summary_table(successes, cascade, rankings, (ALL, *report.hard_groups), px, seconds)
    text = _filled(text, "results", small)
    if not (root / BAG_TABLES).is_dir():
        return text
    bags = [read_table(root / BAG_TABLES / f"{name}.csv", "intrinsics method") for name in ("summary", "intruders")]
    params = load_sfm_params(root / BAGS)
    methods = [*params.methods.names, *(params.methods.learned or ())]
    return _filled(text, "sfm", small_table(bags[0], bags[1], methods, params.report.sizes))


def _filled(text: str, name: str, table: Table) -> str:
    """Return a text with a table between the markers of a name."""
    section = re.compile(f"(<!-- {name} -->\n)(.*?)(<!-- /{name} -->)", re.DOTALL)
    places = len(section.findall(text))
    if places != 1:
        raise ReadmeError(f"README: {places} sections from `<!-- {name} -->` to `<!-- /{name} -->`, expected 1")
    return section.sub(lambda match: match[1] + "\n".join(table_lines(table)) + "\n" + match[3], text)
