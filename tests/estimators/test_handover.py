"""Hand-over: the cuts, one-to-one, spread, and the file that keeps the choices."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from epiprior.errors import FeatureError, SettingsError
from epiprior.estimators import names
from epiprior.estimators.handover import (
    INPUTS,
    HandOver,
    default_hand_over,
    find_hand_overs,
    hand_over,
    load_hand_overs,
    save_hand_overs,
)
from epiprior.matching.selection import one_to_one_mask, spread_mask
from synthetic import make_matches, make_pair


def naive_one_to_one(feature1, feature2):
    used1, used2, keep = set(), set(), []
    for i, j in zip(feature1, feature2, strict=True):
        keep.append(i not in used1 and j not in used2)
        if keep[-1]:
            used1.add(i)
            used2.add(j)
    return np.array(keep, dtype=bool)


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2**40)), max_size=60))
@settings(deadline=None)
def test_one_to_one_is_its_naive_twin(pairs):
    first, second = (np.array([p[k] % (13 if k == 0 else 9) * 10**9 for p in pairs], np.int64) for k in (0, 1))
    assert np.array_equal(one_to_one_mask(first, second), naive_one_to_one(first, second))


def test_one_to_one_of_a_small_case():
    assert one_to_one_mask(np.array([3, 3, 4, 5]), np.array([1, 2, 1, 2])).tolist() == [
        True,
        False,
        False,
        True,
    ]


def test_one_to_one_refuses_nonsense():
    with pytest.raises(FeatureError, match=r"\(2,\) and \(3,\)"):
        one_to_one_mask(np.arange(2), np.arange(3))
    with pytest.raises(FeatureError, match="-4"):
        one_to_one_mask(np.array([1, -4]), np.array([0, 1]))


def test_match_set_one_to_one_keeps_the_better_match():
    m = make_matches(np.zeros((3, 2)), np.zeros((3, 2)), feature1=np.array([0, 0, 1]))
    assert m.one_to_one().feature2.tolist() == [0, 2]


def test_nothing_asked_for_changes_nothing():
    matches = make_pair().matches
    handed = hand_over(matches, HandOver())
    assert np.array_equal(handed.x1, matches.x1)


def test_cuts_come_before_one_to_one_and_top_k():
    """A dropped match must not use up the feature of one that stays."""
    matches = make_matches(
        np.arange(24.0).reshape(12, 2),
        np.arange(24.0).reshape(12, 2),
        probability=np.linspace(1, 0, 12),
        distance_ratio=np.where(np.arange(12) == 0, 0.99, 0.5),
        feature1=np.array([0, 0, *range(1, 11)]),
    )
    handed = hand_over(matches, HandOver(max_distance_ratio=0.9, one_to_one=True, min_probability=0.1, top_k=8))
    assert handed.feature2.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert hand_over(matches, HandOver(min_probability=0.5)).probability.min() >= 0.5


def test_cut_by_probabilities_that_are_not_there_is_refused():
    with pytest.raises(SettingsError, match="no probabilities"):
        hand_over(make_matches(np.zeros((3, 2)), np.zeros((3, 2))), HandOver(min_probability=0.5))


def crowded(seed: int = 0):
    """200 of the best matches in one corner, 300 spread over the image."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(0, 60, (200, 2)), rng.uniform(0, 1000, (300, 2))])
    return make_matches(x, x[:, ::-1], probability=np.linspace(1, 0, 500))


def test_spread_limits_every_cell_in_both_images_and_keeps_the_order():
    matches = crowded()
    handed = hand_over(matches, HandOver(top_k=100, spread=0.1))
    assert len(handed) == 100
    assert np.all(np.diff(handed.feature1) > 0)
    assert handed.feature1[:10].tolist() == list(range(10))
    for x, every in ((handed.x1, matches.x1), (handed.x2, matches.x2)):
        low, size = every.min(axis=0), np.ptp(every, axis=0) / 8
        cells = np.minimum((x - low) // size, 7) @ [1, 8]
        assert np.unique(cells, return_counts=True)[1].max() <= 10
    plain = hand_over(matches, HandOver(top_k=100))
    assert np.ptp(plain.x1, axis=0).max() < 61 < np.ptp(handed.x1, axis=0).min()


def test_spread_looks_at_image_two_as_well():
    rng = np.random.default_rng(1)
    x1 = rng.uniform(0, 1000, (400, 2))
    x2 = np.concatenate([rng.uniform(0, 50, (200, 2)), rng.uniform(0, 1000, (200, 2))])
    assert spread_mask(x1, x2, top_k=100, share=0.1)[:200].sum() <= 4 * 10


def test_spread_of_everything_is_a_share_of_all():
    assert len(hand_over(crowded(), HandOver(spread=1.0))) == 500
    assert len(hand_over(crowded(), HandOver(spread=0.05))) < 400


def test_empty_and_single_sets():
    empty = make_matches(np.zeros((0, 2)), np.zeros((0, 2)), probability=np.zeros(0))
    how = HandOver(one_to_one=True, top_k=8, spread=0.1, min_probability=0.1, max_distance_ratio=0.9)
    assert len(hand_over(empty, how)) == 0
    one = make_matches(np.ones((1, 2)), np.ones((1, 2)), probability=np.ones(1), distance_ratio=np.array([0.5]))
    assert len(hand_over(one, how)) == 1


@pytest.mark.parametrize(
    "bad",
    [
        {"top_k": 7},
        {"top_k": 300.0},
        {"top_k": True},
        {"min_probability": 1.5},
        {"min_probability": np.nan},
        {"max_distance_ratio": 0.0},
        {"spread": 0.0},
        {"threshold_px": 0.0},
        {"threshold_px": None},
        {"one_to_one": 1},
        {"collect": "yes"},
        {"refine": None},
    ],
)
def test_values_out_of_range_are_named(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        HandOver(**bad)


def test_defaults_exist_for_everything_and_differ_in_what_they_take():
    table = {name: {kind: default_hand_over(name, kind) for kind in INPUTS} for name in names()}
    assert table["usac"]["standard"].max_distance_ratio == 0.85
    assert table["beem"]["default"].top_k > table["usac"]["default"].top_k > table["colmap"]["default"].top_k
    assert table["usac"]["default"].collect
    assert not table["usac"]["paper"].refine
    with pytest.raises(SettingsError, match="'lowe'"):
        default_hand_over("usac", "lowe")


def test_file_overrides_what_it_names_and_nothing_else(tmp_path):
    path = tmp_path / "hand_over.json"
    path.write_text('{"usac": {"default": {"top_k": 123, "spread": 0.2}}}')
    table = load_hand_overs(path)
    assert set(table) == set(names())
    assert table["usac"]["default"] == replace(default_hand_over("usac", "default"), top_k=123, spread=0.2)
    assert table["usac"]["snn"] == default_hand_over("usac", "snn")


def test_file_round_trip_is_exact_and_byte_stable(tmp_path):
    table = {"prosac": {"snn": HandOver(threshold_px=0.75), "default": HandOver(top_k=200, spread=0.1)}}
    save_hand_overs(tmp_path / "a.json", table)
    save_hand_overs(tmp_path / "b.json", {"prosac": dict(reversed(table["prosac"].items()))})
    loaded = load_hand_overs(tmp_path / "a.json")
    assert loaded["prosac"]["snn"] == table["prosac"]["snn"]
    assert loaded["prosac"]["default"] == table["prosac"]["default"]
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize(
    ("content", "culprit"),
    [
        ({"usak": {}}, "'usak'"),
        ({"usac": {"lowe": {}}}, "'lowe'"),
        ({"usac": {"snn": {"topk": 3, "top_k": 30}}}, "unknown topk;"),
        ({"usac": {"snn": {"top_k": 3}}}, "usac, snn: top_k is 3"),
        ({"usac": {"snn": []}}, "usac, snn: list"),
        ({"usac": 7}, "usac is int"),
        ([], "the file is list"),
    ],
)
def test_bad_file_names_the_culprit(tmp_path, content, culprit):
    path = tmp_path / "hand_over.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SettingsError, match=rf"hand_over\.json: .*{culprit}"):
        load_hand_overs(path)


def test_unreadable_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"gone\.json: cannot be read"):
        load_hand_overs(tmp_path / "gone.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(SettingsError, match=r"text\.json: not JSON"):
        load_hand_overs(tmp_path / "text.json")


def test_without_a_file_the_defaults_hold(monkeypatch):
    monkeypatch.setattr("epiprior.estimators.handover.find_hand_overs", lambda: None)
    assert load_hand_overs()["magsac++"]["paper"] == default_hand_over("magsac++", "paper")


def test_the_packaged_file_is_valid():
    assert find_hand_overs() is None or find_hand_overs().name == "hand_over.json"
    assert set(load_hand_overs()) == set(names())
