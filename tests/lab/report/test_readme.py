"""The tables of the README: made of the reports, and those that are committed."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from epiprior_lab.cli import app
from epiprior_lab.params import PHOTOGRAPHS as PARAMS
from epiprior_lab.report import readme
from epiprior_lab.report.study import ReportError

ROOT = Path(__file__).parents[3]
PRECISION = "+0.200 [+0.100, +0.300]; +0.050 as a mean over scenes; +0.400 if all were right"
FOUND = "+20 % [-10 %, +50 %]; +120 % if it solved every pair"


@pytest.fixture
def root(tmp_path):
    """A repository with small reports and the study's own parameters."""
    (tmp_path / "reports").mkdir()
    (tmp_path / "params.yaml").write_bytes((ROOT / "params.yaml").read_bytes())
    names = ("usac", "epiprior")
    performance = [
        {"threshold_px": threshold, "family": family, "estimator": name, "pairs": 20}
        | {"without": 9.2, "snn": 10.0 + k, "default": 11.0, "default_over_without": 0.2}
        | {"default_over_without_low": -0.1, "default_over_without_high": 0.5}
        for threshold in (10.0, 3.0)
        for family in ("facades-hard", "open", "all")
        for k, name in enumerate(names)
    ]
    duels = [
        {"threshold_px": 10.0, "family": family, "input": name, "estimator": "usac"}
        | {"difference": 2.5, "difference_low": low, "difference_high": 4.0, "verdict": "better" if low > 0 else "open"}
        for family in ("facades-hard", "open")
        for name, low in (("default", 1.0), ("snn", -0.5))
    ]
    bounds = [
        {"kind": "contribution", "family": "open", "threshold_px": 10.0, "input": "default", "estimator": "usac"}
        | {"wanted": 0.6, "found": 0.2, "low": -0.1, "high": 0.5, "possible": 1.2}
        | {"beaten": np.nan, "others": np.nan, "met": False}
    ]
    successes = [
        {"threshold_px": threshold, "group": group, "estimator": "magsac++", "input": name, "pairs": 5}
        | {
            "successes": threshold / 10 + k,
            "scene_share": 0.25 * (k + 1),
            "gain": 0.5,
            "gain_low": 0.1,
            "gain_high": 0.9,
        }
        for threshold in (10.0, 3.0)
        for group in ("hard", "all", "fox")
        for k, name in enumerate(("standard", "snn", "default"))
    ]
    rankings = [
        {"group": group, "ranking": name, "precision_100": 0.5}
        for group in ("all", "fox")
        for name in ("standard", "snn", "default")
    ]
    sets = [{"set": "open1", "title": "Open1", "state": "not present", "pairs": 246}]
    sets += [{"set": "fox", "title": "fox", "state": "", "pairs": 5}]
    found = [
        {"kind": "precision", "group": "all", "threshold_px": np.nan, "estimator": "", "against": "Lowe's order"}
        | {
            "wanted": 0.18,
            "found": 0.2,
            "low": 0.1,
            "high": 0.3,
            "scene_found": 0.05,
            "possible": 0.4,
            "kept": np.nan,
            "of": np.nan,
        }
        | {"met": True}
    ]
    tables = tmp_path / "reports" / "real" / "tables"
    tables.mkdir(parents=True)
    named = {"successes": successes, "rankings": rankings, "sets": sets, "bounds": found}
    for name, rows in named.items():
        pd.DataFrame(rows).to_csv(tables / f"{name}.csv", index=False)
    runs = {"set": "fox", "pair_id": ["1", "2"] * 2, "estimator": ["usac"] * 2 + ["epiprior"] * 2}
    runs |= {"seconds_without": [1.0, 1.0, 2.0, 2.0], "seconds_with": [2.0, 3.0, 6.0, 12.0]}
    runs |= {"seconds_cascade": [1.0, 2.0, 2.0, 2.0]}
    medians = {"estimator": ["usac", "all"], "seconds_without": 1.0, "seconds_with": 3.0, "seconds_cascade": 1.5}
    time = {"bound": ["with", "cascade"], "wanted": [2.0, 1.3], "found": [2.5, 1.0], "met": [False, True]}
    timings = tmp_path / "reports" / "real" / "timings"
    timings.mkdir()
    for name, columns in (("pairs", runs), ("overhead", medians | {"preprocessed": 0.5}), ("bounds", time)):
        pd.DataFrame(columns).to_csv(timings / f"{name}.csv", index=False)
    (tmp_path / "benchmarks" / "real").mkdir(parents=True)
    (tmp_path / PARAMS).write_bytes((ROOT / PARAMS).read_bytes())
    for name, rows in (("performance", performance), ("duel", duels), ("bounds", bounds)):
        pd.DataFrame(rows).to_csv(tmp_path / "reports" / f"{name}.csv", index=False)
    return tmp_path


def text_with(name):
    return f"before\n<!-- results:{name} -->\nold\n<!-- /results -->\nafter\n"


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        (
            "successes",
            [
                "| estimator | facades-hard (20) | open (20) | all families (20) | ours over without |",
                "|---|---:|---:|---:|---:|",
                "| usac" + " | 9.2 / 10.0 / **11.0**" * 3 + " | +20 % [-10 %, +50 %] |",
                "| epiprior" + " | 9.2 / **11.0** / **11.0**" * 3 + " | +20 % [-10 %, +50 %] |",
            ],
        ),
        (
            "duel",
            [
                "| against | facades-hard, ours | facades-hard, snn | open, ours | open, snn |",
                "|---|---:|---:|---:|---:|",
                "| usac" + " | **+2.5 [+1.0, +4.0]** | +2.5 [-0.5, +4.0]" * 2 + " |",
            ],
        ),
        (
            "bounds",
            [
                "| bound | found | met |",
                "|---|---|---|",
                "| usac gains at least +60 % on open, 10 px | " + FOUND + " | no |",
            ],
        ),
        (
            "photographs",
            [
                (
                    "| estimator: without / snn / ours | hard pairs (5) | all pairs (5) | ours over without "
                    "| hard, % per scene | all, % per scene |"
                ),
                "|---|---:|---:|---:|---:|---:|",
                "| magsac++"
                + " | 1.0 / 2.0 / **3.0**" * 2
                + " | +50 % [+10 %, +90 %]"
                + " | 25 / 50 / **75**" * 2
                + " |",
                "",
                "magsac++, per set: precision of the top 100 / successes below 10 px / below 3 px.",
                "",
                "| set | pairs | X_L | snn | ours |",
                "|---|---:|---:|---:|---:|",
                *(
                    f"| {name} | 5 | 0.50 / 1.0 / 0.3 | 0.50 / 2.0 / 1.3 | 0.50 / 3.0 / 2.3 |"
                    for name in ("fox", "**total**")
                ),
                "| Open1 | 246" + " | not present" * 3 + " |",
            ],
        ),
        (
            "photographs-bounds",
            [
                "| bound | found | met |",
                "|---|---|---|",
                "| precision of the top 100 at least +0.18 over Lowe's order, all pairs | " + PRECISION + " | yes |",
            ],
        ),
        (
            "photographs-time",
            [
                "| bound | wanted | median | mean | seconds, median | met |",
                "|---|---:|---:|---:|---:|---:|",
                "| with | at most 2 | 2.50 | 3.50 | 1.00 → 3.00 | no |",
                "| cascade | at most 1.3 | 1.00 | 1.25 | 1.00 → 1.50 | yes |",
                "",
                "2 pairs, 4 runs of 2 estimators, ratios run by run; the cascade preprocesses in 50 % of them.",
            ],
        ),
    ],
)
def test_tables(name, lines, root):
    got = readme.render_readme(text_with(name), root)
    assert got == text_with(name).replace("old", "\n".join(lines))
    assert readme.render_readme(got, root) == got


def test_the_command_writes_what_changed(root):
    (root / "README.md").write_text(text_with("duel") + text_with("bounds"))
    runner = CliRunner()
    assert "tables written" in runner.invoke(app, ["readme", "--root", str(root)]).output
    text = (root / "README.md").read_text()
    assert "old" not in text
    assert text.count("after\n") == 2
    assert "are those of the reports" in runner.invoke(app, ["readme", "--root", str(root)]).output


def test_bad_markers_are_named(root):
    with pytest.raises(readme.ReadmeError, match="'sucesses', there are successes, duel"):
        readme.render_readme(text_with("sucesses"), root)
    with pytest.raises(readme.ReadmeError, match="has no"):
        readme.render_readme("<!-- results:duel -->\nold\n", root)
    (root / "reports" / "duel.csv").unlink()
    with pytest.raises(ReportError, match=r"duel\.csv"):
        readme.render_readme(text_with("duel"), root)


def test_the_tables_of_the_readme_are_those_of_the_committed_reports():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert {match[2] for match in readme._SECTION.finditer(text)} == readme.TABLES.keys()
    assert readme.render_readme(text, ROOT) == text, "run `epiprior-lab readme`"
