"""Measures against naive computations written with loops."""

import math

import numpy as np
import pytest

from calls import refused
from epiprior.errors import SettingsError
from epiprior_lab import measures
from epiprior_lab.evaluation import statistics as st


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_contribution_is_the_papers_and_over_no_success_infinite():
    np.testing.assert_allclose(st.contribution(27.0, 91.6), 2.3926, atol=1e-4)
    np.testing.assert_allclose(st.contribution([10, 0, 0], [5, 3, 0]), [-0.5, np.inf, 0])
    got = st.paired_bootstrap([0, 0, 0], [1, 0, 1], draws=200, seed=0)
    assert got.contribution.value == got.contribution.high == np.inf
    assert not math.isnan(got.contribution.low)


def test_weights_are_multinomial_by_pair_and_draw_whole_scenes():
    weights = st.bootstrap_weights(6, 4000, 1, None)
    counts = weights * 6
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(counts.mean(axis=0), 1, atol=0.06)
    np.testing.assert_allclose(counts.var(axis=0), 5 / 6, atol=0.08)
    weights = st.bootstrap_weights(6, 300, 2, ("b", "a", "b", "c", "c", "c"))
    for row in weights:
        assert row[0] == row[2]
        assert row[3] == row[4] == row[5]
        counts = np.rint(row[[1, 0, 3]] / row[row > 0].min())
        np.testing.assert_allclose(row[[1, 0, 3]], counts / (counts @ [1, 2, 3]))
    assert (weights[:, 1] == 0).any()


def test_intervals_equal_a_naive_bootstrap_and_bad_input_is_named(rng):
    without, with_step = rng.integers(0, 6, (2, 9)) / 5
    got = st.paired_bootstrap(without, with_step, draws=500, seed=7)
    counts = np.random.default_rng(7).multinomial(9, np.full(9, 1 / 9), size=500)
    a, b, c = [], [], []
    for draw in counts:
        sample = [i for i in range(9) for _ in range(draw[i])]
        a.append(sum(without[i] for i in sample) / 9)
        b.append(sum(with_step[i] for i in sample) / 9)
        c.append((b[-1] - a[-1]) / a[-1])
    for interval, samples, value in (
        (got.without, a, without.mean()),
        (got.with_step, b, with_step.mean()),
        (got.difference, np.subtract(b, a), with_step.mean() - without.mean()),
        (got.contribution, c, with_step.mean() / without.mean() - 1),
    ):
        ordered = sorted(samples)
        assert interval.value == pytest.approx(value)
        assert interval.low == pytest.approx(ordered[math.ceil(0.025 * 500) - 1])
        assert interval.high == pytest.approx(ordered[math.ceil(0.975 * 500) - 1])
    assert st.bootstrap_mean(without, draws=500, seed=7) == got.without
    refused(ValueError, "mismatch", st.paired_bootstrap, [1], [1, 2], draws=5, seed=0)
    refused(ValueError, "mismatch", st.paired_bootstrap, [1, 1], [1, 2], draws=5, seed=0, groups=["a"])


def test_success_curve_and_the_area_below_it(rng):
    errors = rng.exponential(5, (30, 4))
    errors[3, 2], errors[4, 0] = np.nan, np.inf
    thresholds = np.array([0.5, 3, 10, 1e9])
    mean, deviation = st.success_curve(errors, thresholds)
    for t, m, d in zip(thresholds, mean, deviation, strict=True):
        counts = [sum(1 for p in range(30) if errors[p, s] < t) for s in range(4)]
        assert m == pytest.approx(sum(counts) / 4)
        assert d == pytest.approx(math.sqrt(sum((c - m) ** 2 for c in counts) / 3))
    assert mean[-1] == pytest.approx((30 * 4 - 2) / 4)
    np.testing.assert_array_equal(st.success_curve(errors[:, :1], thresholds)[1], 0)
    errors = np.append(rng.exponential(6, 40), [np.inf, np.nan])
    naive = np.mean([(errors < t).mean() for t in (np.arange(20_000) + 0.5) / 2000])
    assert st.area_under_success_curve(errors, 10.0) == pytest.approx(naive, abs=1e-3)


def test_ranking_measures_and_calibration_bins(rng):
    right = rng.random(300) < 0.3
    precisions = [sum(right[: i + 1]) / (i + 1) for i in range(300) if right[i]]
    assert measures.average_precision(right) == pytest.approx(sum(precisions) / len(precisions))
    assert measures.average_precision(np.zeros(4, bool)) == 0
    assert measures.precision_at(right, 100) == sum(right[:100]) / 100
    assert measures.precision_at(right, 500) == sum(right) / 500
    p = np.append(rng.random(500), [0.0, 1.0])
    right = rng.random(502) < p**2
    bins = measures.calibration_bins(p, right, bins=10)
    assert bins.brier_score == pytest.approx(np.mean([(a - b) ** 2 for a, b in zip(p, right, strict=True)]))
    error, curve = 0.0, []
    for b in range(10):
        inside = [i for i in range(502) if b / 10 <= p[i] < (b + 1) / 10 or (b == 9 and p[i] == 1)]
        assert bins.count[b] == len(inside)
        curve.append([np.mean(p[inside]), np.mean(right[inside]), len(inside)])
        error += len(inside) / 502 * abs(np.mean(p[inside]) - np.mean(right[inside]))
    np.testing.assert_allclose(bins.curve, curve)
    assert bins.expected_calibration_error == pytest.approx(error)
    few = measures.calibration_bins(np.array([0.0, 0.1, 1.0]), np.array([False, True, True]), bins=4)
    np.testing.assert_allclose(few.curve, [[0.05, 0.5, 2], [1.0, 1.0, 1]])  # without empty bins
    none = measures.calibration_bins(np.empty(0), np.empty(0, bool))
    assert none.curve.shape == (0, 3)
    assert np.isnan([none.brier_score, none.expected_calibration_error]).all()
    for value in (1.2, np.nan):
        refused(SettingsError, str(value), measures.calibration_bins, np.array([value]), np.array([True]))
