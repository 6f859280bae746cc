from dataclasses import replace

import numpy as np
import pytest

from epiprior_lab.report.bounds import Bound, judge
from epiprior_lab.report.cascade import cascade_table
from epiprior_lab.report.timing import decision_figure, decision_table, overhead_table, seconds_table, write_timings
from synthetic_tables import timing_table

WANTED = [
    Bound(pipeline="study", measure="time", estimator="every", group="all", at_most=2.0),
    Bound(pipeline="study", measure="cascade_time", estimator="every", group="all", at_most=99.0),
]


@pytest.fixture(scope="module")
def timings(study):
    return timing_table(study.results.tables)


def test_overhead_is_a_ratio_of_means_its_bounds_are_medians_and_seconds_are_by_outcome(study, timings):
    table = overhead_table(timings, study.results, 10.0).set_index(["input", "group", "estimator"])
    own = timings[(timings["group"] == "open") & (timings["estimator"] == "usac")]
    means = own.groupby("input")["seconds_total"].mean()
    row = table.loc[("default", "open", "usac")]
    assert row["seconds_without"] == pytest.approx(means["standard"])
    assert row["overhead"] == pytest.approx(means["default"] / means["standard"])
    errors, mask = study.results.errors, study.results.masks["open"]
    a, b = (errors.of("usac", name, 10.0)[mask].mean() for name in ("standard", "default"))
    assert row["contribution"] == pytest.approx(b / a - 1)
    assert np.isnan(table.loc[("cascade", "open", "usac"), "contribution"])
    everyone = timings[timings["input"].isin(["standard", "generalized", "default"])]
    wide = everyone.assign(ranked=everyone["input"] == "default").pivot_table(
        index=["group", "pair_id", "estimator", "seed"], columns="ranked", values="seconds_total"
    )
    assert table.loc[("default", "all", "all"), "median_overhead"] == pytest.approx((wide[True] / wide[False]).median())
    cascade = timings[timings["input"] == "cascade"]
    assert table.loc[("cascade", "all", "all"), "preprocessed"] == pytest.approx(cascade["preprocessed"].mean())
    table = overhead_table(timings, study.results, 10.0)
    judged = judge(WANTED, {"overhead": table})
    found = table[(table["group"] == "all") & (table["estimator"] == "all")].set_index("input")["median_overhead"]
    assert judged["found"].tolist() == [found["default"], found["cascade"]]
    assert judged["met"].tolist() == [found["default"] <= 2.0, True]
    assert judge(WANTED, {}).empty
    table = seconds_table(timings, 10.0).set_index(["estimator", "input", "outcome"])
    own = timings[(timings["estimator"] == "usac") & (timings["input"] == "snn")]
    right = own[own["error_px"] < 10.0]["seconds_estimator"]
    row = table.loc[("usac", "snn", "success")]
    assert row["runs"] == len(right)
    assert row[["mean", "median", "longest"]].tolist() == pytest.approx([right.mean(), right.median(), right.max()])
    assert table["runs"].sum() == (timings["input"] != "cascade").sum()
    assert not table.index.get_level_values("input").isin(["cascade"]).any()


@pytest.mark.slow
def test_files(study, timings, tmp_path):
    write_timings(timings, replace(study, bounds=WANTED), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "bounds.csv", "decision.csv", "decision.png", "estimators.csv", "estimators.png", "overhead.csv",
        "overhead.png", "times.md",
    }  # fmt: skip
    text = (tmp_path / "times.md").read_text()
    assert "median time with preprocessing at most 2 times that without" in text
    assert "4 pairs, 4 estimators" in text


def test_every_input_is_a_point(photographs, tmp_path):
    results, timings = photographs.results, timing_table(photographs.results.tables)
    cascade = cascade_table(results, photographs.rule, results.estimators, (10.0, 3.0))
    table = decision_table(timings, results, (10.0, 3.0), cascade, usual="magsac++")
    timed = ["standard", "generalized", "snn", "aliked", "default", "cascade"]
    assert table["input"].drop_duplicates().tolist() == timed
    usual = set(table.loc[table["choice"] == "usual", "input"])
    assert usual == {"standard", "snn", "default", "cascade"}  # others: best, or none
    row = table[(table["input"] == "cascade") & (table["choice"] == "best")].iloc[0]
    hard = cascade[(cascade["group"] == "hard") & (cascade["threshold_px"] == 10.0)].set_index("estimator")["cascade"]
    assert row["successes_10"] == hard.max() == hard[row["estimator"]]
    assert (table["pairs"] == results.hard_pairs.sum()).all()
    row = table[table["input"] == "aliked"].iloc[0]
    counts = {e: results.errors.of(e, "aliked", 10.0)[results.hard_pairs].sum() for e in ("usac", "magsac++")}
    assert row["successes_10"] == max(counts.values()) == counts[row["estimator"]]
    own = timings[(timings["input"] == "aliked") & (timings["estimator"] == row["estimator"])]
    assert row["seconds_pair"] == pytest.approx(own["seconds_total"].mean())
    assert row["seconds_pair"] - row["seconds_shared"] == pytest.approx(0.5)  # of features
    decision_figure(table, tmp_path / "decision.png")
    assert (tmp_path / "decision.png").stat().st_size > 10_000
