"""The null model: counts, rates, and that noise does not pass while real support does."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import binom

from epiprior.geometry import sampson_distance
from epiprior.verification.chance import HYPOTHESES, chance_rate, distinct_count, expected_by_chance, log_chance
from synthetic import make_pair


def test_distinct_count_takes_shared_points_once():
    x1 = np.array([[0.0, 0], [0, 0], [1, 0], [2, 0]])
    x2 = np.array([[5.0, 0], [6, 0], [7, 0], [7, 0]])
    assert (distinct_count(x1, x2), distinct_count(x1[:0], x2[:0])) == (3, 0)
    x = np.array([[0.0, 1], [1, 0], [0, 0], [1, 1]])  # points that differ in one coordinate
    assert distinct_count(x, x) == 4


def test_rate_is_that_of_fresh_random_matches_sees_that_points_are_crowded_and_is_cautious_where_there_are_none():
    pair = make_pair(inliers=200, outliers=200)
    y1, y2 = np.random.default_rng(7).uniform(0, [1024, 768], (2, 200_000, 2))
    for threshold_px in (1.0, 3.0):
        expected = np.mean(sampson_distance(pair.F, y1, y2) < threshold_px)
        assert chance_rate(pair.F, pair.matches.x1, pair.matches.x2, threshold_px) == pytest.approx(expected, rel=0.35)
    pair = make_pair(inliers=400, outliers=0)
    near = np.linalg.norm(pair.matches.x1 - pair.matches.x1[0], axis=1) < 60
    x1, x2 = pair.matches.x1, pair.matches.x2
    assert chance_rate(pair.F, x1[near], x2[near], 1.5) > 3 * chance_rate(pair.F, x1, x2, 1.5)
    assert [chance_rate(pair.F, x1[:n], x2[:n], 1.5) for n in (0, 1)] == [1.0, 1.0]


def test_log_chance_is_the_binomial_law():
    """With 93 free matches of 100 and a rate of 0.5 %, 6 free supporters are the first that count."""
    for supporters, free in ((13, 5), (12, 4)):
        assert log_chance(supporters, 100, 0.005, fitted=7) == pytest.approx(5 + math.log10(binom.sf(free, 93, 0.005)))
    assert log_chance(13, 100, 0.005, fitted=7) < 0 < log_chance(12, 100, 0.005, fitted=7)
    assert log_chance(100, 100, 1.0, fitted=7) == pytest.approx(5)
    assert log_chance(1000, 1000, 1e-6, fitted=7) == pytest.approx(-295)
    # Of eight matches there are only eight samples, so that one free supporter says something.
    assert log_chance(8, 8, 0.01, fitted=7) == pytest.approx(math.log10(8 * 0.01))
    assert log_chance(8, 100, 0.01, fitted=7) > 0
    for supporters, matches in ((0, 0), (7, 7), (7, 100), (2, 5)):  # what the sample explains anyway
        assert log_chance(supporters, matches, 1e-6, fitted=7) >= 0


def test_rates_of_their_own_follow_the_law_of_their_sum_beyond_what_made_the_hypothesis():
    """Twin: all outcomes of six matches, the two least probable supporters left out as those that made it."""
    rates = np.array([0.5, 0.02, 0.3, 0.9, 0.1, 0.2, 0.05, 0.4])
    agrees = np.array([1, 1, 0, 1, 0, 1, 1, 0], np.bool_)
    left = np.array([0.5, 0.3, 0.9, 0.1, 0.2, 0.4])
    outcomes = np.array(list(itertools.product([0, 1], repeat=6)))
    weights = np.prod(np.where(outcomes == 1, left, 1 - left), axis=1)
    expected = math.comb(8, 2) * weights[outcomes.sum(axis=1) >= 3].sum()
    assert expected_by_chance(agrees, rates, fitted=2) == pytest.approx(expected)
    assert expected_by_chance(np.arange(9) < 2, np.full(9, 0.1), fitted=2) == math.inf
    assert expected_by_chance(np.zeros(0, np.bool_), np.zeros(0), fitted=2) == math.inf
    assert expected_by_chance(np.ones(9, np.bool_), np.ones(9), fitted=2) == math.comb(9, 2)
    for supporters in (8, 13, 40):  # equal rates: the binomial law
        found = expected_by_chance(np.arange(100) < supporters, np.full(100, 0.05), fitted=7)
        assert found == pytest.approx(HYPOTHESES * binom.sf(supporters - 8, 93, 0.05), rel=1e-9)
