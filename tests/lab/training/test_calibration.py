import numpy as np
import pytest
from scipy.special import expit, logit
from sklearn.linear_model import LogisticRegression

from epiprior.ranking.models import calibrate
from epiprior_lab.measures import calibration_bins
from epiprior_lab.training.calibration import CalibrationError, cross_calibrate, fit_platt, fit_sigmoid


def overconfident(size=20_000, seed=0):
    """Labels drawn with p, and probabilities of a classifier: twice the logit, shifted."""
    rng = np.random.default_rng(seed)
    p = expit(rng.normal(-2, 1.5, size))
    return expit(2 * logit(p) + 1), rng.random(size) < p, p


def test_platt_finds_the_distortion_and_the_sigmoid_is_that_of_unpenalised_logistic_regression():
    said, labels, p = overconfident()
    a, b = fit_platt(said, labels)
    assert (a, b) == (pytest.approx(0.5, abs=0.02), pytest.approx(-0.5, abs=0.05))
    better = calibrate(said, a, b)
    assert np.abs(better - p).max() < 0.03
    before, after = (calibration_bins(each, labels).expected_calibration_error for each in (said, better))
    assert after < 0.01 < before
    said, labels, _ = overconfident(seed=1)
    score = 1000 + 50 * logit(said)  # far from the origin and wide
    a, b = fit_sigmoid(score, labels)
    reference = LogisticRegression(C=np.inf, tol=1e-10).fit(logit(said)[:, None], labels)
    assert a * 50 == pytest.approx(reference.coef_[0, 0], rel=2e-3)
    assert a * 1000 + b == pytest.approx(reference.intercept_[0], rel=2e-3)
    assert fit_sigmoid(score, labels, (a * 1.1, b)) == pytest.approx((a, b), rel=1e-7)


def test_platt_is_strictly_increasing_and_finite_for_separated_classes():
    calibrated = calibrate(np.linspace(0, 1, 1001), 0.7, -0.3)
    assert (np.diff(calibrated) > 0).all()
    assert 0 < calibrated[0] < calibrated[-1] < 1
    a, b = fit_sigmoid(np.arange(20.0), np.arange(20) >= 10)
    assert 0 < a < 100
    assert -b / a == pytest.approx(9.5, abs=0.1)
    said = np.linspace(0.1, 0.9, 12)
    np.testing.assert_array_equal(cross_calibrate(said, np.arange(12) < 6, np.arange(12) % 2), said)
    for labels in (np.zeros(10, bool), np.ones(10, bool), np.arange(10) < 5):  # one class, or a reversed ranking
        with pytest.raises(CalibrationError):
            fit_platt(np.linspace(0.1, 0.9, 10), labels)


def test_cross_calibration_does_not_see_the_row():
    said, labels, _ = overconfident(600)
    fold = np.arange(600) % 3
    before = cross_calibrate(said, labels, fold)
    for number in range(3):
        held = fold == number
        wanted = calibrate(said[held], *fit_platt(said[~held], labels[~held]))
        np.testing.assert_allclose(before[held], wanted, rtol=1e-6)
    changed = labels.copy()
    changed[fold == 1] &= np.arange(np.count_nonzero(fold == 1)) % 2 == 0
    after = cross_calibrate(said, changed, fold)
    np.testing.assert_allclose(before[fold == 1], after[fold == 1], rtol=1e-6)
    assert (np.abs(before[fold == 0] / after[fold == 0] - 1) > 1e-3).all()
