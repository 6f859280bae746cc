"""Inputs that are not ranked: standard matches, mutual nearest neighbours, candidates of generalised RANSAC."""

from dataclasses import fields

import numpy as np
import pytest

import epiprior
import epiprior.matching.pair
from calls import refused
from epiprior.errors import FeatureError
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.matching.baselines import (
    _candidates,
    generalized_matches,
    snn_matches,
    snn_of_largest,
    standard_matches,
)
from epiprior.presets import DEFAULT, PAPER
from pictures import relief_pair
from synthetic import unit_rows

SMALL_PAIR = relief_pair(320, 240)


@pytest.mark.parametrize("make", [standard_matches, snn_matches, generalized_matches])
def test_handed_in_features_give_what_detection_gives(make, monkeypatch):
    pair = SMALL_PAIR
    wanted = make(*pair)
    settings = DEFAULT.features if make is snn_matches else PAPER.features
    features1, features2 = (detect_features(load_photograph(image), settings) for image in pair)
    monkeypatch.setattr(epiprior.matching.pair, "detect_features", None)  # nothing is detected again
    got = make(*pair, features1=features1, features2=features2)
    assert len(got) > 100
    for column in fields(got):
        np.testing.assert_array_equal(getattr(got, column.name), getattr(wanted, column.name), err_msg=column.name)
    for features, rows, xy in ((features1, got.feature1, got.x1), (features2, got.feature2, got.x2)):
        np.testing.assert_array_equal(features.xy[rows], xy)
        used = features.take(np.unique(rows))
        assert len(np.unique(np.column_stack([used.xy, used.scale]), axis=0)) == len(used)  # of twins, one
    half1, half2 = (features.take(np.arange(0, len(features), 2)) for features in (features1, features2))
    assert len(half1) > len(make(*pair, features1=half1, features2=features2)) > 10
    assert 10 < len(make(*pair, features1=features1, features2=half2)) < len(got)
    refused(FeatureError, "image 2 belong to", make, pair[0], pair[1][:-10], features1=features1, features2=features2)


def naive_candidates(S, threshold, limit):
    """Pairs above a threshold that are among the `limit` most similar of their row and of their column."""
    above = {(i, j): S[i, j] for i in range(S.shape[0]) for j in range(S.shape[1]) if S[i, j] >= threshold}
    kept = set()
    for (i, j), value in above.items():
        rivals1 = sorted((-s, b) for (a, b), s in above.items() if a == i)
        rivals2 = sorted((-s, a) for (a, b), s in above.items() if b == j)
        if (-value, j) in rivals1[:limit] and (-value, i) in rivals2[:limit]:
            kept.add((i, j))
    return kept


@pytest.mark.parametrize(("n1", "n2"), [(40, 25), (700, 12), (1, 1)])
@pytest.mark.parametrize("limit", [1, 3, 1000])
def test_candidates_equal_the_naive_search(n1, n2, limit):
    rng = np.random.default_rng(n1)
    d1, d2 = unit_rows(rng, n1, 6), unit_rows(rng, n2, 6)
    rows, to, similarity = _candidates(d1, d2, 0.4, limit)
    assert set(zip(rows, to, strict=True)) == naive_candidates(d1 @ d2.T, 0.4, limit)
    np.testing.assert_allclose(similarity, (d1[rows] * d2[to]).sum(axis=1), rtol=1e-4)


def test_candidates_share_a_low_probability_and_are_sorted():
    matches = generalized_matches(*SMALL_PAIR)
    assert len(matches) > 100
    count1, count2 = (np.bincount(f)[f] for f in (matches.feature1, matches.feature2))
    np.testing.assert_allclose(matches.probability, 0.5 / np.maximum(count1, count2))
    assert count1.max() > 1
    key = list(zip(-matches.probability, -matches.similarity, strict=True))
    assert key == sorted(key)
    assert matches.similarity.min() >= 0.85
    nearest = matches.distance_ratio < 1
    assert (nearest | (matches.similarity_weight == 0)).all()
    standard = standard_matches(*SMALL_PAIR, max_distance_ratio=1.0)  # whose columns they share
    pairs = {tuple(pair) for pair in np.column_stack([matches.feature1, matches.feature2])[nearest].tolist()}
    assert len(pairs) > 50
    assert pairs <= set(zip(standard.feature1.tolist(), standard.feature2.tolist(), strict=True))
    assert len(generalized_matches(np.full((200, 200), 128, np.uint8), SMALL_PAIR[0])) == 0


def test_standard_matches_are_the_papers_and_snn_is_mutual():
    found = standard_matches(*SMALL_PAIR)
    assert (np.diff(found.distance_ratio) >= 0).all()
    assert found.distance_ratio.max() <= 0.9
    assert np.isnan(found.probability).all()
    fewer = standard_matches(*SMALL_PAIR, max_distance_ratio=0.6)
    assert 0 < len(fewer) < len(found)
    np.testing.assert_array_equal(fewer.x1, found.x1[: len(fewer)])
    found = snn_matches(*SMALL_PAIR)
    assert (np.diff(found.distance_ratio) >= 0).all()
    assert found.distance_ratio.max() < 0.85
    assert len({tuple(x) for x in np.column_stack([found.x2, found.orientation2_deg])}) == len(found)


@pytest.mark.parametrize("start", [120, 150, 200])
def test_matches_of_the_largest_features_are_those_of_all_between_them(start):
    features = [detect_features(load_photograph(image), DEFAULT.features) for image in SMALL_PAIR]
    of_all = snn_matches(None, None, features1=features[0], features2=features[1])
    sizes = [np.sort(one.scale)[::-1] for one in features]
    largest = next(n for n in range(start, start + 100) if all(own[n - 1] > own[n] for own in sizes))
    least = [own[largest - 1] for own in sizes]
    both = (of_all.scale1 >= least[0]) & (of_all.scale2 >= least[1])
    some = [one.take(np.argsort(-one.scale, kind="stable")[:largest]) for one in features]
    among_themselves = snn_matches(None, None, features1=some[0], features2=some[1])
    assert 10 < both.sum() < len(among_themselves)
    for swap in (False, True):
        got = snn_of_largest(*(features[::-1] if swap else features), largest=largest)
        got, wanted = got.swapped() if swap else got, of_all.take(np.flatnonzero(both))
        assert len(got) == len(wanted)
        in_order = [m.take(np.lexsort(np.column_stack([m.x1, m.x2]).T)) for m in (got, wanted)]
        for column in ("x1", "x2", "feature1", "feature2", "distance_ratio", "similarity", "similarity_weight"):
            one, two = (getattr(m, column) for m in in_order)
            np.testing.assert_allclose(one, two, rtol=1e-3, err_msg=column)
