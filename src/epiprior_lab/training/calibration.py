"""Calibration of probabilities: Platt scaling of logits, expected calibration error, reliability curve."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from epiprior.errors import EpipriorError
from epiprior.ranking.models import calibrate
from epiprior.types import BoolArray, FloatArray, IntArray

_CLIP = 1e-7
_ITERATIONS = 100


class CalibrationError(EpipriorError, ValueError):
    """Probabilities cannot be calibrated: one class only, or they rank wrong matches before right ones."""


@dataclass(frozen=True)
class Platt:
    """``sigmoid(a * logit(p) + b)``.

    Parameters
    ----------
    a, b : float
        Slope, > 0, and offset.
    """

    a: float
    b: float

    def __call__(self, probability: FloatArray) -> FloatArray:
        """Return calibrated probabilities, shape (N,)."""
        return calibrate(probability, self.a, self.b)


@dataclass(frozen=True)
class Reliability:
    """Reliability curve; bins without a row are left out.

    Parameters
    ----------
    predicted, observed : ndarray, shape (B,), float64
        Mean probability and share of right ones of each bin.
    count : ndarray, shape (B,), int64
        Rows of each bin.
    """

    predicted: FloatArray
    observed: FloatArray
    count: IntArray


def fit_sigmoid(score: FloatArray, labels: BoolArray) -> tuple[float, float]:
    """Fit ``P(label) = sigmoid(a * score + b)`` by maximum likelihood.

    Parameters
    ----------
    score : ndarray, shape (N,), float64
        Any real score, finite.
    labels : ndarray, shape (N,), bool
        Both classes must be there.

    Returns
    -------
    a, b : float
        Slope and offset.

    Raises
    ------
    CalibrationError
        If there is one class only, or the best slope is not positive.

    Notes
    -----
    Newton's method on Platt's softened targets ``(n1 + 1) / (n1 + 2)`` and ``1 / (n0 + 2)``, which keep the
    slope finite where the scores separate the classes.

    References
    ----------
    Lin, Lin, Weng, "A note on Platt's probabilistic outputs for support vector machines", 2007.
    """
    right = int(np.count_nonzero(labels))
    wrong = len(labels) - right
    if not right or not wrong:
        raise CalibrationError(f"{right} right and {wrong} wrong rows: a calibration needs both")
    target = np.where(labels, (right + 1) / (right + 2), 1 / (wrong + 2))
    spread = float(np.std(score)) or 1.0
    middle = float(np.mean(score))
    x = (np.asarray(score, np.float64) - middle) / spread

    def loss(at: FloatArray) -> float:
        margin = at[0] * x + at[1]
        return float(np.sum(np.logaddexp(0.0, margin) - target * margin))

    theta = np.array([0.0, np.log((right + 1) / (wrong + 1))])
    current = loss(theta)
    for _ in range(_ITERATIONS):
        p = expit(theta[0] * x + theta[1])
        # Plain sums, no matrix products: those depend on the number of threads in the last bits.
        error, weight = p - target, p * (1 - p)
        gradient = np.array([np.sum(error * x), np.sum(error)])
        mixed = float(np.sum(weight * x))
        hessian = np.array([[np.sum(weight * x * x), mixed], [mixed, np.sum(weight)]]) + 1e-9 * np.eye(2)
        step = np.linalg.solve(hessian, gradient)
        size = 1.0
        while (proposed := loss(theta - size * step)) > current and size > 1e-10:
            size /= 2
        if not proposed < current:
            break
        theta, gain, current = theta - size * step, current - proposed, proposed
        if gain < 1e-12 * abs(current):
            break
    a, b = float(theta[0]) / spread, float(theta[1]) - float(theta[0]) * middle / spread
    if not a > 0:
        raise CalibrationError(f"the slope is {a:.3g}: higher scores do not mean right ones")
    return a, b


def fit_platt(probability: FloatArray, labels: BoolArray) -> Platt:
    """Fit Platt scaling to out-of-fold probabilities.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        Of rows that the classifier was not trained on, in [0, 1].
    labels : ndarray, shape (N,), bool
        Which rows are right.

    Returns
    -------
    Platt
        To apply to the classifier's probabilities.

    Raises
    ------
    CalibrationError
        See `fit_sigmoid`.
    """
    return Platt(*fit_sigmoid(logit(np.clip(probability, _CLIP, 1 - _CLIP)), labels))


def cross_calibrate(probability: FloatArray, labels: BoolArray, fold: IntArray) -> FloatArray:
    """Return out-of-fold probabilities, each calibrated on the rows of the other folds.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        Out-of-fold probabilities.
    labels : ndarray, shape (N,), bool
        Which rows are right.
    fold : ndarray, shape (N,), int64
        Fold of each row; at least two.

    Returns
    -------
    ndarray, shape (N,), float64
        In (0, 1): what a calibration measures without having seen the row. A fold stays as it is where the
        others cannot be calibrated.
    """
    result = np.array(probability, np.float64)
    for number in np.unique(fold):
        held = fold == number
        with contextlib.suppress(CalibrationError):
            result[held] = fit_platt(probability[~held], labels[~held])(probability[held])
    return result


def reliability(probability: FloatArray, labels: BoolArray, *, bins: int = 15) -> Reliability:
    """Return the reliability curve over bins of equal width.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        In [0, 1].
    labels : ndarray, shape (N,), bool
        Which rows are right.
    bins : int
        Bins of [0, 1], >= 1.

    Returns
    -------
    Reliability
        Empty for no rows.
    """
    index = np.minimum((np.asarray(probability) * bins).astype(np.int64), bins - 1)
    count = np.bincount(index, minlength=bins)
    kept = count > 0
    predicted = np.bincount(index, weights=probability, minlength=bins)[kept] / count[kept]
    observed = np.bincount(index, weights=labels.astype(np.float64), minlength=bins)[kept] / count[kept]
    return Reliability(predicted, observed, count[kept].astype(np.int64))


def expected_calibration_error(probability: FloatArray, labels: BoolArray, *, bins: int = 15) -> float:
    """Return the mean distance of the reliability curve from the diagonal, by rows; NaN for no rows."""
    if not len(probability):
        return float("nan")
    curve = reliability(probability, labels, bins=bins)
    return float(np.sum(curve.count * np.abs(curve.predicted - curve.observed)) / np.sum(curve.count))
