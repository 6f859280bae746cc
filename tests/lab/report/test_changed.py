from dataclasses import replace

import pandas as pd

from epiprior_lab.pairsets.changed import EVERY
from epiprior_lab.report.results import Results
from epiprior_lab.report.sections import changed
from epiprior_lab.report.tables import changed_table
from synthetic_tables import photograph_tables

THRESHOLDS = (10.0, 3.0)


def test_changed_pairs_stand_beside_the_same_pairs_as_they_were(photographs):
    tables = photograph_tables()
    assert changed_table(Results(tables, photographs.params), THRESHOLDS).empty
    frames = {}
    for name in tables.kinds:
        table = getattr(tables, name)
        turned = table[(table["group"] == "fox") & table["pair_id"].isin(["0001", "0004"])]
        turned = turned.assign(group="turned90", pair_id="fox-" + turned["pair_id"])
        if name == "runs":  # no longer found, but for what is learnt
            turned["error_px"] = turned["error_px"].where(turned["input"] == "aliked", 99.0)
        frames[name] = pd.concat([table, turned], ignore_index=True)
    results = Results(replace(tables, **frames), photographs.params, apart=["turned90"])
    table = changed_table(results, THRESHOLDS)
    assert set(table["group"]) == {"turned90"}
    assert (table["pairs"] == 2).all()
    row = table[(table["input"] == "snn") & (table["threshold_px"] == 10.0)].iloc[0]
    pairs = (results.tables.pairs["group"] == "fox") & results.tables.pairs["pair_id"].isin(["0001", "0004"])
    assert row["unchanged"] == results.errors.of(row["estimator"], "snn", 10.0)[pairs].sum() > 0
    assert row["successes"] == 0
    learnt = table[table["input"] == "aliked"]
    assert (learnt["successes"] == learnt["unchanged"]).all()
    blocks = list(changed(replace(photographs, results=results, tables={"changed": table})))
    assert blocks[0].startswith(f"One pair in {EVERY}")
    assert [block.head for block in blocks[2::2]] == [["matches", "estimator", "as they are (2)", "turned90"]] * 2
    assert blocks[2].rows[2] == ["snn", row["estimator"], f"{row['unchanged']:.1f}", "0.0"]
