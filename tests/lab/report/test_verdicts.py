"""The verdict's own table: false alarms and hits, by hand."""

import numpy as np
import pandas as pd
import pytest

from epiprior_lab.report import verdicts
from epiprior_lab.report.verdicts import (
    VERDICT_HEAD,
    study_verdicts,
    verdict_figure,
    verdict_markdown,
    verdict_rows,
    verdict_table,
)

RUNS = pd.DataFrame(
    [
        ("snn", "ok", 1.0),
        ("snn", "degenerate", 2.0),
        ("snn", "no_model", 9.9),
        ("snn", "ok", 10.0),  # wrong: not below the threshold
        ("snn", "degenerate", 50.0),
        ("snn", "no_model", np.nan),  # no F, so nothing to judge
        ("default", "ok", 3.0),
        ("default", "too_few_matches", np.nan),
    ],
    columns=["input", "status", "error_px"],
)


def test_false_alarms_and_hits_are_counted():
    table = verdict_table({"open": RUNS, "rolled": RUNS[RUNS["input"] == "snn"]}, 10.0)
    rows = table.set_index(["group", "input"])
    assert list(rows.index) == [("open", "snn"), ("open", "default"), ("open", "all"), ("rolled", "snn")]
    snn = rows.loc[("open", "snn")]
    assert snn[["runs", "without_F", "right", "right_no_model", "right_degenerate"]].tolist() == [6, 1, 3, 1, 1]
    assert snn[["wrong", "wrong_no_model", "wrong_degenerate"]].tolist() == [2, 0, 1]
    assert snn["right_turned_down"] == pytest.approx(2 / 3)
    assert snn["wrong_turned_down"] == 0.5
    ours = rows.loc[("open", "default")]
    assert (ours["right_turned_down"], ours["without_F"]) == (0.0, 1)
    assert np.isnan(ours["wrong_turned_down"])
    assert rows.loc[("open", "all"), ["right", "right_degenerate", "wrong"]].tolist() == [4, 1, 2]
    assert rows.loc[("rolled", "snn")].equals(snn)


def test_rows_for_a_reader():
    table = verdict_table({"open": RUNS}, 10.0)
    rows = verdict_rows(table)
    assert rows[0] == ["open", "snn", "1", "3", "1", "1", "66.7 %", "2", "0", "1", "50.0 %"]
    assert rows[1][-1] == ""
    assert {len(row) for row in rows} == {len(VERDICT_HEAD)}
    text = "\n".join(verdict_markdown(table, 10.0))
    assert "| " + " | ".join(rows[2]) + " |" in text
    assert "below 10 px" in text


def test_a_study_has_its_families_and_all(tmp_path):
    class Study:
        results = pd.concat([RUNS.assign(family="rolled"), RUNS.assign(family="open")], ignore_index=True)
        families = ("open", "rolled")

    table = study_verdicts(Study(), 10.0)
    assert list(dict.fromkeys(table["group"])) == ["open", "rolled", "all"]
    assert table[(table["group"] == "all") & (table["input"] == "all")]["right"].item() == 8
    paths = [verdict_figure(table, tmp_path / f"{name}.png") for name in "ab"]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_tallest_bar_ends_below_the_top(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(verdicts, "save", lambda figure, path: figures.append(figure) or path)
    runs = pd.concat([RUNS, RUNS.replace({"status": "degenerate"}, "ok")])  # two of six right F are turned down
    verdict_figure(verdict_table({"open": runs}, 10.0), tmp_path / "v.png")
    alarms, hits = figures[0].axes
    tallest = max(bar.get_y() + bar.get_height() for bar in alarms.patches)
    assert tallest == pytest.approx(50.0)
    assert 1.1 * tallest < alarms.get_ylim()[1] <= 100
    assert hits.get_ylim() == (0, 100)
