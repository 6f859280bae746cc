"""The search of hand-overs: what is varied, what is tried, when a setting is left."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calls import note_calls
from epiprior.estimators.handover import HandOver, default_hand_over
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation import inputs
from epiprior_lab.params import HandOverParams, WeightedParams
from epiprior_lab.selection import hand_over_search
from epiprior_lab.selection.hand_over_search import Trial, choose
from synthetic import make_pair

NUMBERS = {"max_distance_ratio": (0.7, 0.8, 0.9), "top_k": (100, 300, 500, None), "threshold_px": (1.0, 1.5, 2.0)}
FLAGS = dict.fromkeys(("one_to_one", "refine", "collect"), (True, False))
WEIGHTED = WeightedParams(estimators=("epiprior",), top_k=(300, 2000))
PARAMS = HandOverParams(seeds=(0, 1), weighted=WEIGHTED, **NUMBERS, **FLAGS)
SEARCHED = {"usac": ("standard", "default"), "prosac": ("standard", "default"), "epiprior": ("generalized", "default")}


@pytest.fixture
def search(monkeypatch):
    """Search on two pairs whose errors are those of a function of the hand-over."""
    points, calls, sets = 2 * (np.zeros((1, 2)),), [], (make_pair().matches,)
    pairs = [SimpleNamespace(pair_id=f"pair-{k}", files=(), control_points=lambda: points) for k in range(2)]

    def run(error):
        def solve(sets, *, estimator, hand_over, **_):
            calls.append((estimator, hand_over))
            return SimpleNamespace(F=error(estimator, hand_over))

        monkeypatch.setattr(hand_over_search, "solve", solve)
        return hand_over_search.search_hand_overs(pairs, inputs=SEARCHED, params=PARAMS, files=(), store=Path())

    for name, fake in {
        "map_tasks": lambda function, tasks, **_: [function(**task.payload) for task in tasks],
        "store_matches": lambda pairs, names, *_, **__: [dict.fromkeys(names, Path()) for _ in pairs],
        "read_matches": lambda files: inputs.PairMatches(sets=dict.fromkeys(files, sets), pixel_factors=(1.0, 1.0)),
        "error_px": lambda F, *points: np.nan if F is None else F,
        "_effect": lambda matches, name, how: how,
    }.items():
        monkeypatch.setattr(hand_over_search, name, fake)
    return SimpleNamespace(run=run, calls=calls)


def made_up_error(estimator, how):
    """An error with one best hand-over per input; for prosac nothing matters, for epiprior nothing is found."""
    if estimator == "prosac":
        return 5.0
    if estimator == "epiprior":
        return None
    penalty = 4 * abs(how.threshold_px - 1.0)
    if how.max_distance_ratio is not None:
        penalty += 80 * abs(how.max_distance_ratio - 0.7)
    else:
        penalty += abs((how.top_k or 1000) - 300) / 50 + how.refine
    return 1.0 + penalty + how.one_to_one


def test_search_finds_the_best_hand_over(search):
    best, trials = search.run(made_up_error)
    assert best["usac", "standard"].how == HandOver(max_distance_ratio=0.7, threshold_px=1.0)
    assert best["usac", "default"].how == HandOver(top_k=300, threshold_px=1.0, collect=True)
    assert best["usac", "default"].score[0] == 2 * 4  # two pairs, two seeds, both thresholds
    # Where nothing matters, or nothing is found, the starting point stays.
    for place in (("prosac", "default"), ("epiprior", "default"), ("epiprior", "generalized")):
        assert best[place].how == default_hand_over(*place)
    tried = [(t.place, t.how) for t in trials]
    assert len(tried) == len(set(tried))
    seeds = [1 if name == "epiprior" else 2 for (name, _), _ in tried]  # that is deterministic
    assert len(search.calls) == 2 * sum(seeds)  # nothing runs twice
    table = hand_over_search.trial_table(best, trials)
    assert table["chosen"].sum() == len(best) == 6
    row = table[table["chosen"]].set_index(["estimator", "input"]).loc[("usac", "default")]
    assert (row["step"], row["top_k"], row["pairs"], row["successes_10"]) == ("one_to_one", 300, 2, 2.0)
    assert list(best) == [(estimator, name) for estimator, names in SEARCHED.items() for name in names]


def test_every_input_is_searched_by_what_matters_for_it():
    def varied(estimator, name):
        return dict(hand_over_search.coordinates(estimator, name, PARAMS))

    assert varied("epiprior", "default")["top_k"] == (300, 2000)
    assert varied("usac", "default")["top_k"] == PARAMS.top_k
    assert varied("generalized-ransac", "generalized")["top_k"] == (300, 2000)
    for name in ("standard", "snn"):
        assert {"max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"} == varied("usac", name).keys()
    assert {"refine", "collect"}.isdisjoint(varied("usac", "paper"))  # as printed


def trial(errors, top_k=None):
    return Trial(place=("usac", "snn"), step="top_k", how=HandOver(top_k=top_k), errors_px=np.array(errors))


def test_score_counts_both_thresholds_and_a_hand_over_is_left_only_for_gains_above_their_standard_error():
    def one_pair(*errors):
        return trial([errors])

    assert one_pair(9.0, 9.0, 2.0).score > one_pair(1.0, np.nan, np.nan).score
    assert one_pair(1.0, np.nan).score[0] == one_pair(9.0, 9.0).score[0] == 2
    assert one_pair(9.0, 2.0).score > max(one_pair(4.0, 4.0).score, one_pair(9.5, 2.0).score)
    assert one_pair(10.0, np.nan).score == (0, 0.0)

    def pairs(errors, top_k=None):
        return trial(np.array(errors)[:, None], top_k)

    known = pairs([50.0] * 8 + [0.5] * 8)
    lucky = pairs([0.5, 0.5, *[50.0] * 6, 50.0, *[0.5] * 7], top_k=100)  # two pairs won, one lost
    better = pairs([0.5, 0.5, 0.5, *[50.0] * 5, *[0.5] * 8], top_k=300)
    best = pairs([*[0.5] * 6, 50.0, 50.0, 50.0, *[0.5] * 7], top_k=500)
    gain = lucky.pair_scores - known.pair_scores
    assert 0 < gain.mean() < gain.std(ddof=1) / 4
    assert lucky.score > known.score
    assert not lucky.gains_on(known)
    assert not known.gains_on(known)
    assert choose(known, [lucky]) is known
    assert choose(known, [lucky, better]) is better
    assert choose(known, [lucky, best, better]) is best
    assert pairs([0.5]).gains_on(pairs([2.0]))


def test_equal_matches_are_estimated_once(pairs, monkeypatch, tmp_path):
    [files] = inputs.store_matches(pairs[:1], ("standard", "snn"), tmp_path)
    how = HandOver(max_distance_ratio=0.9, threshold_px=1.0)
    changes = ({}, {"max_distance_ratio": None}, {"top_k": 10_000}, {"top_k": 50}, {"threshold_px": 2.0})
    hows = [replace(how, **change) for change in changes]  # the first three hand over the same
    calls = note_calls(monkeypatch, hand_over_search, "solve")
    tried = {
        "pair": pairs[0],
        "matches": {"snn": files["snn"]},
        "place": ("usac", "snn"),
        "hows": hows,
        "seeds": (0, 1),
    }
    got = hand_over_search.candidate_errors(**tried)
    assert [options["seed"] for _, options in calls] == [child_seed(seed, "relief-0") for seed in (0, 1)] * 3
    assert (got < 1).all()
    np.testing.assert_array_equal(got[:3], got[[0, 0, 0]])
