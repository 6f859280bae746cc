"""Successes against seconds, and successes on changed photographs."""

from dataclasses import replace

import pandas as pd
import pytest

from epiprior_lab.pairsets.changed import EVERY
from epiprior_lab.report.decision import decision_figure, decision_table
from epiprior_lab.report.material import Material
from epiprior_lab.report.result_sections import changed
from epiprior_lab.report.results import Results
from epiprior_lab.report.tables import changed_table
from synthetic_tables import photograph_tables, timing_table

THRESHOLDS = (10.0, 3.0)


def test_every_input_is_a_point(photographs, tmp_path):
    results, timings = photographs.results, timing_table(photographs.results.tables)
    table = decision_table(timings, results, THRESHOLDS, usual="epiprior")
    assert table["input"].drop_duplicates().tolist() == ["standard", "generalized", "snn", "aliked", "default"]
    assert set(table.loc[table["choice"] == "usual", "input"]) == {"standard", "snn", "default"}
    assert (table["pairs"] == results.hard_pairs.sum()).all()
    row = table[table["input"] == "aliked"].iloc[0]
    counts = {e: results.errors.of(e, "aliked", 10.0)[results.hard_pairs].sum() for e in ("usac", "magsac++")}
    assert row["successes_10"] == max(counts.values()) == counts[row["estimator"]]
    own = timings[(timings["input"] == "aliked") & (timings["estimator"] == row["estimator"])]
    assert row["seconds_pair"] == pytest.approx(own["seconds_total"].median())
    assert row["seconds_pair"] - row["seconds_shared"] == pytest.approx(0.5)  # of features
    decision_figure(table, tmp_path / "decision.png")
    assert (tmp_path / "decision.png").is_file()


def test_changed_pairs_stand_beside_the_same_pairs_as_they_were(photographs):
    tables = photograph_tables()
    assert changed_table(Results(tables, by="difficulty", hard=("hard",), draws=100, seed=0), THRESHOLDS).empty
    frames = {}
    for name in tables.kinds:
        table = getattr(tables, name)
        turned = table[(table["group"] == "fox") & table["pair_id"].isin(["0001", "0004"])]
        turned = turned.assign(group="turned90", pair_id="fox-" + turned["pair_id"])
        if name == "runs":  # no longer found, but for what is learnt
            turned["error_px"] = turned["error_px"].where(turned["input"] == "aliked", 99.0)
        frames[name] = pd.concat([table, turned], ignore_index=True)
    results = Results(replace(tables, **frames), by="difficulty", hard=("hard",), apart=["turned90"], draws=100, seed=0)
    table = changed_table(results, THRESHOLDS)
    assert set(table["group"]) == {"turned90"}
    assert (table["pairs"] == 2).all()
    row = table[(table["input"] == "snn") & (table["threshold_px"] == 10.0)].iloc[0]
    pairs = (results.tables.pairs["group"] == "fox") & results.tables.pairs["pair_id"].isin(["0001", "0004"])
    assert row["unchanged"] == results.errors.of(row["estimator"], "snn", 10.0)[pairs].sum() > 0
    assert row["successes"] == 0
    learnt = table[table["input"] == "aliked"]
    assert (learnt["successes"] == learnt["unchanged"]).all()
    how = {"params": photographs.params, "figures": {}, "kind": "photographs", "extras": photographs.extras}
    blocks = list(changed(Material(results=results, tables={"changed": table}, **how)))
    assert blocks[0].startswith(f"One pair in {EVERY}")
    assert [block.head for block in blocks[2::2]] == [["matches", "estimator", "as they are (2)", "turned90"]] * 2
    assert blocks[2].rows[2] == ["snn", row["estimator"], f"{row['unchanged']:.1f}", "0.0"]
