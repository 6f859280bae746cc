import numpy as np
import pytest

from epiprior_lab.measures import calibration_bins


def test_the_reliability_curve_by_hand():
    bins = calibration_bins(np.array([0.0, 0.1, 0.3, 1.0]), np.array([False, True, False, True]), bins=4)
    np.testing.assert_allclose(bins.curve, [[0.05, 0.5, 2], [0.3, 0.0, 1], [1.0, 1.0, 1]])
    assert bins.expected_calibration_error == pytest.approx((2 * 0.45 + 0.3 + 0) / 4)


def test_no_rows_have_no_curve():
    bins = calibration_bins(np.empty(0), np.empty(0, bool))
    assert bins.curve.shape == (0, 3)
    assert np.isnan(bins.expected_calibration_error)
