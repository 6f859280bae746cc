"""The table of the README: made of the committed report."""

import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from calls import refused
from epiprior_lab.cli import app
from epiprior_lab.evaluation.records import TableError
from epiprior_lab.params import PHOTOGRAPHS
from epiprior_lab.report import readme

ROOT = Path(__file__).parents[3]
ESTIMATOR_OF_X_L = re.compile(r"\| X_L \| (\S+) \|")
TEXT = "before\n<!-- results -->\nold\n<!-- /results -->\nafter\n"


@pytest.fixture
def root(tmp_path, photograph_report):
    shutil.copytree(photograph_report[1] / "tables", tmp_path / readme.TABLES)
    (tmp_path / readme.TIMES).parent.mkdir()
    best = ESTIMATOR_OF_X_L.search((photograph_report[1] / "performance.md").read_text())
    rows = [f"standard,{best[1]},{seconds}\n" for seconds in (9.0, 2.34, 0.1)]
    (tmp_path / readme.TIMES).write_text("input,estimator,seconds_total\nsnn,nobody,5\n" + "".join(rows))
    (tmp_path / PHOTOGRAPHS).parent.mkdir(parents=True)
    shutil.copy(ROOT / PHOTOGRAPHS, tmp_path / PHOTOGRAPHS)
    (tmp_path / "README.md").write_text(TEXT)
    return tmp_path


def test_the_table_is_the_small_one_of_the_report_and_the_command_writes_what_changed(root, photograph_report):
    got = readme.render_readme(TEXT, root)
    head = "| matches | estimator | features | seconds | all pairs (12), 10 px |"
    assert got.startswith(f"before\n<!-- results -->\n{head}")
    assert got.endswith("|\n<!-- /results -->\nafter\n")
    lines = got.splitlines()[2:-2]
    assert len(lines) == 2 + 7
    page = (photograph_report[1] / "performance.md").read_text()
    for line in lines[2:]:
        name, estimator, features, seconds, *shares = line.strip("| ").split(" | ")
        assert seconds.strip() == ("3.8" if name == "X_L" else "")  # the mean of what was timed, no other estimator's
        assert f"| {' | '.join([name, estimator, features, *shares])} |" in page
    assert readme.render_readme(got, root) == got
    runner = CliRunner()
    runner.invoke(app, ["readme", "--root", str(root)], catch_exceptions=False)
    assert "old" not in (root / "README.md").read_text()
    before = (root / "README.md").read_bytes()
    runner.invoke(app, ["readme", "--root", str(root)], catch_exceptions=False)
    assert (root / "README.md").read_bytes() == before


def test_bad_markers_and_a_missing_report_are_named(root):
    for text in ("nothing", TEXT + TEXT, "<!-- results -->\nold\n"):
        refused(readme.ReadmeError, "expected 1", readme.render_readme, text, root)
    (root / readme.TABLES / "cascade.csv").unlink()
    refused(TableError, r"cascade\.csv", readme.render_readme, TEXT, root)


def test_the_table_of_the_readme_is_that_of_the_committed_report():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.render_readme(text, ROOT) == text, "run `epiprior-lab readme`"
