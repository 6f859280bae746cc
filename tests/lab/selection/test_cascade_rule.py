"""Rules of the cascade: what they keep and lose, and how they are learnt."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.selection import cascade_rule
from epiprior_lab.selection.cascade_rule import ALL, NEVER, cascade_errors, kept_runs, learn_rule, lost_runs
from synthetic_tables import study_tables

PARAMS = CascadeParams(seeds=(0,), tolerance=0.01, strict_tolerance=0.01, min_confidence=(0.0, 0.25, 0.5, 0.75))
AT = {"success_px": 10.0, "strict_px": 3.0}
INF = float("inf")


def runs_of(rows, estimator="usac"):
    """Rows are (scene, confidence, error of the first input, error of the second)."""
    table = pd.DataFrame(rows, columns=["scene", "confidence", "error_px", "with_error_px"])
    for which in ("", "with_"):
        nothing = np.isinf(table[f"{which}error_px"])
        table[f"{which}status"] = np.where(nothing, "no_model", "ok")
        table[f"{which}geometry"] = np.where(nothing, "none", "general")
    table["pair_id"] = [f"pair-{i}" for i in range(len(table))]
    return table.assign(estimator=estimator, group="open", seed=0)


def test_runs_are_paired_and_other_inputs_left_out():
    runs = study_tables(pairs=2).runs
    got = cascade_rule.paired_runs(runs)
    keys = ["group", "pair_id", "estimator", "seed"]
    assert len(got) == 2 * 2 * 4 * 3
    both = runs.set_index([*keys, "input"])
    for row in got.itertuples():
        key = (row.group, row.pair_id, row.estimator, row.seed)
        first, second = both.loc[(*key, "snn")], both.loc[(*key, "default")]
        assert (row.status, row.with_status) == (first["status"], second["status"])
        assert (row.geometry, row.with_geometry) == (first["geometry"], second["geometry"])
        assert row.error_px == (INF if np.isnan(first["error_px"]) else first["error_px"])  # whatever its status
        assert row.with_error_px == (INF if np.isnan(second["error_px"]) else second["error_px"])
    with pytest.raises(pd.errors.MergeError):
        cascade_rule.paired_runs(pd.concat([runs, runs[runs["input"] == "snn"].iloc[:1]]))


def test_a_cascade_takes_one_or_the_other_and_falls_back():
    kept, preprocessed, in_vain = ("a", 0.6, 1.0, 2.0), ("b", 0.4, 50.0, 2.0), ("c", 0.3, 3.0, INF)
    nothing, kept_though_wrong = ("d", np.nan, INF, INF), ("e", 0.6, 30.0, 1.0)
    runs = runs_of([kept, preprocessed, in_vain, nothing, kept_though_wrong])
    kept = kept_runs(runs, [CascadeRule(min_confidence=0.5), NEVER])
    assert kept.tolist() == [[True, False, False, False, True], [False] * 5]
    assert cascade_errors(runs, kept[0]).tolist() == [1.0, 2.0, 3.0, INF, 30.0]
    assert lost_runs(runs, kept, 10.0).tolist() == [[False, False, False, False, True], [False] * 5]
    assert lost_runs(runs, kept, 1.5)[0].tolist() == [False, False, False, False, True]
    runs = runs_of([("a", 0.6, 50.0, 2.0), ("b", 0.6, 50.0, 2.0)])  # the status decides, even where it is wrong
    runs["with_status"], runs["with_geometry"] = "degenerate", "planar"
    runs.loc[1, ["status", "geometry"]] = "degenerate", "planar"
    assert cascade_errors(runs, np.array([False, False])).tolist() == [50.0, 2.0]
    assert kept_runs(runs.assign(confidence=0.05), [CascadeRule(min_confidence=0.9)]).tolist() == [[False, True]]


def many_runs(n=60, seed=0):
    """Right answers are plausible, wrong ones are not."""
    rng = np.random.default_rng(seed)
    right = rng.random(n) < 0.5
    confidence = np.where(right, rng.uniform(0.55, 0.99, n), rng.uniform(0, 0.2, n))
    scenes = [f"s{i}" for i in range(n)]
    return runs_of(list(zip(scenes, confidence, np.where(right, 0.5, 40.0), np.full(n, 0.7), strict=True)))


def test_the_learnt_rule_tells_right_from_wrong_is_strict_and_the_trade_off_falls_from_never_to_always():
    runs = many_runs()
    found = learn_rule(runs, PARAMS, **AT)
    outcome = found.outcomes.loc["usac"]
    assert found.rule == CascadeRule(min_confidence=0.5)  # 0.25 would keep as much
    assert outcome["preprocessed"] == pytest.approx(1 - (runs["error_px"] < 10).mean())
    assert (outcome["lost"], outcome["held_out_lost"]) == (0.0, 0.0)
    assert outcome["held_out_preprocessed"] == pytest.approx(outcome["preprocessed"], abs=0.1)
    assert [rule.min_confidence for rule in cascade_rule.candidate_rules(PARAMS)] == [1.0, 0.75, 0.5, 0.25, 0.0]
    assert cascade_rule.candidate_rules(PARAMS)[0] is NEVER
    runs = many_runs(seed=2).assign(confidence=np.linspace(0, 0.99, 60))
    front = cascade_rule.trade_off(runs, PARAMS, 10.0)
    first, last = front.iloc[0], front.iloc[-1]
    assert (len(front), first["preprocessed"], first["lost"], last["preprocessed"]) == (5, 1.0, 0.0, 0.0)
    assert (np.diff(front["preprocessed"]) < 0).all()
    assert (np.diff(front["lost"]) >= 0).all()
    assert last["lost"] == (runs["error_px"] > 10).mean()


def test_each_tolerance_holds_at_its_own_threshold_and_wins_buy_nothing():
    rows = [("a", 0.9, 1.0, 1.0)] * 97 + [("b", 0.9, 5.0, 1.0)] * 3
    runs = runs_of([(f"{scene}{i}", *rest) for i, (scene, *rest) in enumerate(rows)])
    loose = replace(PARAMS, strict_tolerance=0.03)
    assert learn_rule(runs, PARAMS, **AT).rule == NEVER
    assert learn_rule(runs, loose, **AT).outcomes.loc[ALL, "preprocessed"] == 0.0
    wrong = runs.assign(error_px=runs["error_px"].replace(5.0, 50.0))
    assert learn_rule(wrong, loose, **AT).rule == NEVER
    assert learn_rule(wrong, replace(loose, tolerance=0.03), **AT).rule != NEVER
    won = pd.concat([runs, runs_of([(f"w{i}", 0.9, 1.0, 50.0) for i in range(50)])], ignore_index=True)
    assert learn_rule(won, PARAMS, **AT).rule == NEVER


def test_a_rule_has_a_margin_and_held_out_shares_show_one_that_one_scene_decides():
    """0.5 parts right from wrong, but the wrong one is just below: 0.75 is chosen though it keeps less."""
    right = [(f"r{i}", 0.9, 1.0, 1.0) for i in range(10)] + [(f"q{i}", 0.6, 1.0, 1.0) for i in range(10)]
    found = learn_rule(runs_of([*right, ("w", 0.49, 50.0, 1.0)]), PARAMS, **AT)
    assert found.rule == CascadeRule(min_confidence=0.75)
    assert found.outcomes.loc[ALL, "preprocessed"] == pytest.approx(11 / 21)
    assert learn_rule(runs_of([*right, ("w", 0.2, 50.0, 1.0)]), PARAMS, **AT).rule == CascadeRule(min_confidence=0.5)
    # The only wrong answer that is plausible: without its scene, the rule would keep it.
    rows = [(f"{p}-{i}", p, 1.0, 1.0) for p in (0.8, 0.4) for i in range(30)]
    found = learn_rule(runs_of([*rows, ("bad", 0.4, 90.0, 1.0)]), PARAMS, **AT)
    assert (found.rule.min_confidence, found.outcomes.loc[ALL, "lost"]) == (0.75, 0.0)
    assert found.outcomes.loc[ALL, "held_out_lost"] == pytest.approx(1 / 61)


def test_one_rule_serves_all_and_one_fooled_estimator_does_not_decide_alone():
    """`usac` takes one freak scene of 50 for a good one, which is 2 % of its own runs but not of all."""
    good = [(f"s{i}", 0.9, 1.0, 1.0) for i in range(49)]
    others = [runs_of([*good, ("freak", 0.1, 50.0, 1.0)], estimator=name) for name in ("prosac", "beem")]
    usac = runs_of([*good, ("freak", 0.9, 50.0, 1.0)])
    assert learn_rule(usac, PARAMS, **AT).rule == NEVER
    found = learn_rule(pd.concat([usac, *others], ignore_index=True), PARAMS, **AT)
    assert found.rule == CascadeRule(min_confidence=0.75)
    assert list(found.outcomes.index) == ["usac", "prosac", "beem", ALL]
    assert found.outcomes["lost"].to_list() == pytest.approx([1 / 50, 0, 0, 1 / 150])
    assert found.outcomes["preprocessed"].to_list() == pytest.approx([0, 1 / 50, 1 / 50, 2 / 150])
