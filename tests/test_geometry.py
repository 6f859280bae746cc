"""Distances and fits are those of plain twins; refinement never loses score and follows the weights."""

import numpy as np
import pytest

import naive
from epiprior import geometry
from epiprior.errors import FeatureError
from epiprior.geometry import eight_point, normalise_fundamental, refine_fundamental, sampson_distance, weighted_score
from synthetic import make_pair


def test_distances_and_weighted_fits_are_those_of_the_plain_way():
    pair = make_pair()
    m = pair.matches
    wanted = [naive.sampson(pair.F, a, b) for a, b in zip(m.x1, m.x2, strict=True)]
    assert sampson_distance(pair.F, m.x1, m.x2) == pytest.approx(wanted, rel=1e-9)
    assert sampson_distance(-3 * pair.F.T, m.x2[::2], m.x1[::2]) == pytest.approx(wanted[::2], rel=1e-9)
    assert np.isinf(sampson_distance(np.zeros((3, 3)), m.x1, m.x2)).all()
    assert sampson_distance(pair.F, m.x1[:0], m.x2[:0]).shape == (0,)
    with pytest.raises(FeatureError, match=r"\(300, 2\) and \(299, 2\)"):
        sampson_distance(pair.F, m.x1, m.x2[1:])
    pair = make_pair(inliers=60, outliers=10)
    m = pair.matches
    weights = np.random.default_rng(0).uniform(0.1, 1, 70)
    wanted = normalise_fundamental(naive.eight_point(m.x1, m.x2, weights))
    assert eight_point(m.x1, m.x2, weights) == pytest.approx(wanted, abs=1e-9)
    assert eight_point(m.x1[:7], m.x2[:7]) is None
    assert eight_point(m.x1, m.x2, (np.arange(70) < 7) * 1.0) is None


@pytest.mark.parametrize(("columns", "numbers"), [(1, 3), (1, 40), (2, 3), (4, 10**9)])
def test_first_of_equal_is_the_slow_way(columns, numbers):
    rng = np.random.default_rng(columns)
    for n in (0, 1, 2, 30, 500):
        rows = rng.integers(-numbers, numbers, (n, columns)) / 7.0
        rows[rng.random(n) < 0.2] = rows[:1]
        found = [tuple(row) for row in rows]
        assert geometry.first_of_equal(rows).tolist() == [k for k in range(n) if found.index(found[k]) == k]
    # The sign of zero makes no difference.
    assert geometry.first_of_equal(np.array([[0.0, 1.0], [-0.0, 1.0]])).tolist() == [0]


def rough_start(pair, seed: int):
    """An F from the right matches with 8 px of added noise: wrong by one to several pixels."""
    rng = np.random.default_rng(seed)
    x1, x2 = pair.matches.x1[pair.right], pair.matches.x2[pair.right]
    return eight_point(x1 + rng.normal(0, 8.0, x1.shape), x2 + rng.normal(0, 8.0, x2.shape))


def test_a_rough_start_is_mended_nearly_as_well_as_by_the_right_matches_and_weights_decide_between_two_motions():
    errors = []
    for seed in range(6):
        pair = make_pair(inliers=60, outliers=200, seed=seed)
        start, m = rough_start(pair, seed), pair.matches
        once = eight_point(m.x1[pair.right], m.x2[pair.right])
        refined = refine_fundamental(start, m.x1, m.x2, m.probability)
        errors.append([pair.error_px(F) for F in (start, refined, once)])
    start, refined, once = np.array(errors).T
    assert start.min() > 1.0 > 0.6 > refined.max()
    assert np.median(refined) < 1.5 * np.median(once)
    # The same matches twice, once moved by 6 px in image 2: F follows those that are probable.
    pair = make_pair(inliers=100, outliers=0, seed=1)
    moves = (np.zeros(2), np.array([0.0, 6.0]))
    x1 = np.concatenate([pair.matches.x1] * 2)
    x2 = np.concatenate([pair.matches.x2 + move for move in moves])
    for move, weights in zip(moves, ([1.0, 0.02], [0.02, 1.0]), strict=True):
        F = refine_fundamental(pair.F, x1, x2, np.repeat(weights, 100))
        assert weighted_score(F, pair.control1, pair.control2 + move, np.ones(400)) > 300


@pytest.mark.parametrize("seed", range(3))
def test_the_score_never_falls(seed):
    pair = make_pair(inliers=30, outliers=300, order=1.0, seed=seed)
    m = pair.matches
    wrong = normalise_fundamental(np.random.default_rng(seed).normal(size=(3, 3)))
    for start in (rough_start(pair, seed), pair.F, wrong):
        refined = refine_fundamental(start, m.x1, m.x2, m.probability)
        before, after = (weighted_score(G, m.x1, m.x2, m.probability) for G in (start, refined))
        assert after >= before


def test_too_few_matches_return_the_start_and_perfect_ones_score_one_each():
    pair = make_pair(inliers=7, outliers=0)
    assert refine_fundamental(pair.F, pair.matches.x1, pair.matches.x2) is pair.F
    many = make_pair(inliers=50, outliers=0)
    assert refine_fundamental(many.F, many.matches.x1, many.matches.x2, np.zeros(50)) is many.F
    assert refine_fundamental(many.F, many.matches.x1, many.matches.x2, thresholds=()) is many.F
    pair = make_pair(inliers=40, outliers=0, noise_px=0.0)
    weights = np.linspace(0, 1, 40)
    assert weighted_score(pair.F, pair.matches.x1, pair.matches.x2, weights) == pytest.approx(weights.sum())
    assert weighted_score(pair.F, pair.matches.x1, pair.matches.x2 + 500.0, weights) < 1.0
