"""The table of results in the README, made of the committed report on photographs.

It stands between ``<!-- results -->`` and ``<!-- /results -->``; everything else is left alone.
"""

import re
from pathlib import Path

from epiprior.errors import EpipriorError
from epiprior_lab.params import PHOTOGRAPHS, load_params
from epiprior_lab.report.material import features_by_input, summary_table
from epiprior_lab.report.page import table_lines
from epiprior_lab.report.results import read_table
from epiprior_lab.report.text import ALL

TABLES = Path("reports/real/tables")
_SECTION = re.compile(r"(<!-- results -->\n)(.*?)(<!-- /results -->)", re.DOTALL)
_SUCCESSES = "threshold_px group estimator input pairs successes"
_CASCADE = "threshold_px group estimator pairs cascade"


class ReadmeError(EpipriorError):
    """The README has not exactly one place for the table of results."""


def render_readme(text: str, root: Path) -> str:
    """Return a text with the table between the markers made anew, of the reports below `root`.

    A ReadmeError says that there is not exactly one place for it, a ReportError that the report lacks something.
    """
    places = len(_SECTION.findall(text))
    if places != 1:
        raise ReadmeError(f"README: {places} sections from `<!-- results -->` to `<!-- /results -->`, expected 1")
    report = load_params(root / PHOTOGRAPHS).report
    successes = read_table(root / TABLES / "successes.csv", _SUCCESSES)
    cascade = read_table(root / TABLES / "cascade.csv", _CASCADE)
    px = (report.success_px, report.strict_px)
    features = features_by_input(read_table(root / TABLES / "rankings.csv", "group"))
    lines = table_lines(summary_table(successes, cascade, (ALL, *report.hard_groups), px, features))
    return _SECTION.sub(lambda match: match[1] + "\n".join(lines) + "\n" + match[3], text)
