import numpy as np
import pytest

from epiprior_lab.training.cross_validation import mean_over_pairs, pair_metrics, precision_of_top, row_metrics


def ranked(probability, labels, *slices, share=None):
    share = np.ones(len(slices)) if share is None else np.array(share)
    return mean_over_pairs(pair_metrics(probability, labels, slices, share))


def test_precision_of_the_top_by_hand_of_ties_in_part_and_over_pairs():
    labels = np.array([True, False, True, True, False])
    probability = np.array([0.9, 0.8, 0.7, 0.6, 0.5])
    assert precision_of_top(probability, labels, 2) == 0.5
    assert precision_of_top(probability, labels, 3) == pytest.approx(2 / 3)
    assert precision_of_top(probability, labels, 100) == pytest.approx(3 / 5)
    assert np.isnan(precision_of_top(np.empty(0), np.empty(0, bool), 100))
    labels = np.array([True, True, True, False])
    probability = np.array([0.9, 0.5, 0.5, 0.5])
    expected = (1 + 2 / 3) / 2
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [3, 0, 1, 2]):
        assert precision_of_top(probability[order], labels[order], 2) == pytest.approx(expected)
    labels = np.concatenate([np.ones(300, bool), [False, True], [False, False]])
    probability = np.concatenate([np.ones(300), [0.9, 0.1], [0.5, 0.4]])
    found = ranked(probability, labels, slice(0, 300), slice(300, 302), slice(302, 304), slice(304, 304))
    assert found["precision_top_100"] == pytest.approx((1 + 0.5 + 0) / 3)
    assert found["average_precision"] == pytest.approx((1 + 0.5) / 2)
    assert all(np.isnan(value) for value in ranked(np.empty(0), np.empty(0, bool), slice(0, 0)).values())


def test_a_sample_estimates_the_top_of_all_rows():
    rng = np.random.default_rng(1)
    size, every = 20_000, slice(0, 4000)
    labels = rng.random(size) < 0.05
    probability = rng.normal(size=size) + 2.5 * labels
    whole = ranked(probability, labels, slice(0, size))["precision_top_100"]
    estimates = []
    for _ in range(50):
        kept = rng.choice(size, 4000, replace=False)
        estimates.append(ranked(probability[kept], labels[kept], every, share=[0.2])["precision_top_100"])
    assert np.mean(estimates) == pytest.approx(whole, abs=0.03)
    assert ranked(probability[kept], labels[kept], every)["precision_top_100"] < whole - 0.05


def test_row_metrics_by_hand_and_where_they_are_not_defined():
    found = row_metrics(np.array([0.8, 0.6, 0.4, 0.0]), np.array([True, False, True, False]))
    assert found["accuracy"] == found["precision"] == 0.5
    assert found["brier_score"] == pytest.approx((0.04 + 0.36 + 0.36 + 0) / 4)
    assert found["log_loss"] == pytest.approx(-np.log([0.8, 0.4, 0.4, 1 - 1e-7]).mean())
    assert found["expected_calibration_error"] == pytest.approx((0.2 + 0.6 + 0.6 + 0) / 4)
    one_class = row_metrics(np.full(3, 0.1), np.zeros(3, bool))
    assert np.isnan(one_class["precision"])
    assert (one_class["brier_score"], one_class["log_loss"]) == pytest.approx((0.01, -np.log(0.9)))
    assert all(np.isnan(value) for value in row_metrics(np.empty(0), np.empty(0, bool)).values())
