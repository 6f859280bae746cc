from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calls import refused
from epiprior_lab.report.bounds import BOUNDS, Bound, bound_table, judge, load_bounds
from epiprior_lab.report.results import ReportError

ROOT = Path(__file__).parents[3]


def successes(**gains):
    """Successes of estimators on 20 hard pairs: 10 without, and ours with the gains as told."""
    rows = []
    for estimator, gain in gains.items():
        row = {"threshold_px": 10.0, "group": "hard", "estimator": estimator, "pairs": 20}
        rows.append(row | {"input": "standard", "successes": 10.0, "gain": np.nan})
        rows.append(row | {"input": "default", "successes": 10 * (1 + gain), "gain": gain})
        rows[-1] |= {"gain_low": gain - 1, "gain_high": gain + 1}
    return pd.DataFrame(rows)


def duels(*lows):
    row = {"threshold_px": 10.0, "group": "hard", "input": "default", "pairs": 20, "other": 12.0, "difference": 3.0}
    row["difference_high"] = 5.0
    return pd.DataFrame(row | {"estimator": f"r{k}", "difference_low": low} for k, low in enumerate(lows))


def one(results, bound, **tables):
    judged = judge([bound], tables, results)
    return judged.iloc[0], bound_table(judged).rows[0]


def bound(measure, group="hard", **values):
    return Bound(pipeline="photographs", measure=measure, group=group, threshold_px=10.0, **values)


def test_a_contribution_is_met_by_its_value_and_not_without_pairs(photographs):
    wanted = bound("contribution", estimator="usac", against="baseline", at_least=0.6)
    row, words = one(photographs.results, wanted, successes=successes(usac=0.6 - 1e-12))
    assert row["met"]
    assert row["possible"] == pytest.approx(1.0)
    assert words[0] == "usac gains at least +60 % over X_L: hard pairs, 10 px"
    assert words[1:] == ["+60 % [-40 %, +160 %]; +100 % if it solved every pair", "yes"]
    assert not one(photographs.results, wanted, successes=successes(usac=0.59))[0]["met"]
    refused(ReportError, "no results of usac on hard", one, photographs.results, wanted, successes=successes(beem=0.6))
    wanted = bound("contribution", group="open", estimator="usac", at_least=0.1)
    row, words = one(photographs.results, wanted, successes=successes(usac=1.0))
    assert not row["met"]
    assert words[1:] == ["no such pair", "no"]


def test_every_estimator_has_to_keep_to_a_bound_and_a_duel_is_met_by_intervals(photographs):
    wanted = bound("contribution", estimator="every", against="baseline", at_least=-0.01)
    row, words = one(photographs.results, wanted, successes=successes(usac=-0.01, beem=0.2))
    assert row[["met", "kept", "of"]].tolist() == [True, 2, 2]
    row, words = one(photographs.results, wanted, successes=successes(usac=-0.0126, beem=0.2))
    assert row[["met", "kept", "of", "estimator"]].tolist() == [False, 1, 2, "usac"]
    assert words[0] == "no estimator loses more than 1 %: hard pairs, 10 px"
    assert words[1] == "1 of 2 keep to it; lowest is usac: -1.3 % [-101.3 %, +98.7 %]"
    wanted = bound("difference", estimator="epiprior", against="every", at_least=0.0)
    row, words = one(photographs.results, wanted, duels=duels(0.5, 0.1))
    assert row[["met", "kept", "against", "possible"]].tolist() == [True, 2, "r1", 8.0]
    assert words[0] == "epiprior beats every other estimator on ours: hard pairs, 10 px"
    assert words[1] == "2 of 2 beaten; closest is r1: +3.0 [+0.1, +5.0] pairs, at most +8.0 if it solved every pair"
    assert not one(photographs.results, wanted, duels=duels(0.5, 0.0))[0]["met"]


def test_the_best_peer_is_chosen_in_hindsight_and_our_bounds_are_judged(photographs, photograph_report, tmp_path):
    table = photograph_report[0]["successes"]
    hard = table[(table["group"] == "hard") & (table["threshold_px"] == 10)]
    peer = hard[hard["input"] != "default"]["successes"].max()
    own = hard[(hard["estimator"] == "epiprior") & (hard["input"] == "default")]["successes"].iloc[0]
    wanted = bound("contribution", estimator="epiprior", against="best_peer", at_least=own / peer - 1)
    row, words = one(photographs.results, wanted)
    assert row["found"] == pytest.approx(own / peer - 1)
    assert row["met"]
    assert row["low"] <= row["found"] <= row["high"]
    assert f"over {row['against']}" in words[1]
    judged = photograph_report[0]["bounds"]
    wanted = load_bounds(ROOT / BOUNDS, "photographs")
    assert len(judged) == len([b for b in wanted if "time" not in b.measure])
    ranking = photograph_report[0]["rankings"].set_index(["group", "input", "ranking"]).loc[("all", "default", "final")]
    row = judged[judged["measure"] == "precision_gain"].iloc[0]
    assert (row["found"], row["met"]) == (ranking["gain"], ranking["gain"] >= 0.18)
    assert bound_table(judged).rows[0][0] == "precision of the top 100 at least +0.18 over X_L: all pairs"
    for text in ("- {pipeline: study, measure: luck, group: all}", "- {wish: 1}", "[", ""):
        (tmp_path / "bounds.yaml").write_text(text)
        refused(ReportError, r"bounds\.yaml", load_bounds, tmp_path / "bounds.yaml", "study")
