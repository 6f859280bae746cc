import numpy as np
import pandas as pd
import pytest

from epiprior_lab.report.confidence import confidence_figure, confidence_table, kind_rows, kind_table, labelled


def made_up(right, wrong, unrelated, flat=0.1, *, told="planar"):
    """Return records: ten pairs of each kind, with confidences as given, and as many inliers as per mille."""
    rows = []
    for kind, error, confidence in (
        ("pair", 2.0, right), ("pair", 40.0, wrong), ("unrelated", np.nan, unrelated), ("plane", np.nan, flat)
    ):  # fmt: skip
        for k in range(10):
            value = confidence + 0.01 * k
            row = {"kind": kind, "estimator": "usac", "input": "snn", "status": "ok" if value > 0.5 else "no_model"}
            row |= {"geometry": told if kind == "plane" else "none", "confidence": value, "error_px": error}
            rows.append(row | {"support": round(1000 * value), "matches": 2000})
    return pd.DataFrame(rows)


def scores(kinds):
    return confidence_table(kinds, 10.0).set_index(["estimator", "score"]).loc["usac"]


def test_the_score_tells_right_from_wrong_and_kinds_are_counted_by_verdict_and_drawn(tmp_path):
    good, bad = scores(made_up(0.8, 0.2, 0.1)), scores(made_up(0.1, 0.2, 0.8))
    assert (good[["auc", "kept"]] == 1).all(axis=None)
    assert bad.loc["confidence", ["auc", "kept"]].tolist() == [0, 0]
    row = good.loc["confidence"]
    assert (row["flat_told"], row["false_flat"]) == (1, 0)
    # Confidences of 0.845, 0.245 and 0.145 in the mean, of which 1, 0 and 0 are right.
    assert row["calibration_error"] == pytest.approx((0.155 + 0.245 + 0.145) / 3, abs=1e-9)
    kinds = made_up(0.8, 0.2, 0.1, told="identical")
    counts = labelled(kinds, 10.0)["kind"].value_counts().to_dict()
    assert counts == dict.fromkeys(("right", "wrong", "unrelated", "plane"), 10)
    table = kind_table(kinds, 10.0).set_index(["estimator", "kind"]).loc["usac"]
    assert table["accepted"].to_dict() == {"right": 1, "wrong": 0, "unrelated": 0, "plane": 0}
    assert table.loc["plane", ["told", "identical"]].tolist() == [1, 1]
    both = pd.concat([kinds, kinds.assign(input="cascade", confidence=0.0)])
    sums = kind_table(both, 10.0).groupby(["estimator", "input"])["estimates"].sum()
    assert sums.to_dict() == {("usac", "snn"): 40, ("usac", "cascade"): 40, ("all", "all"): 40}  # nothing counts twice
    page = kind_rows(kind_table(kinds, 10.0))
    assert list(page.head) == ["estimator", "input", "right", "wrong", "unrelated", "plane"]
    assert page.rows[0][2] == "100 % / 0 % of 10"
    confidence_figure(made_up(0.8, 0.2, 0.1), 10.0, tmp_path / "confidence.png")
    assert (tmp_path / "confidence.png").read_bytes().startswith(b"\x89PNG")
