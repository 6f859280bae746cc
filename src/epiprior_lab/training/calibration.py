"""Platt scaling of classifiers' probabilities."""

import contextlib

import numpy as np
from scipy.special import expit, logit

from epiprior.errors import EpipriorError
from epiprior.ranking.models import calibrate
from epiprior.types import BoolArray, FloatArray, IntArray

_CLIP = 1e-7
_ITERATIONS = 100


class CalibrationError(EpipriorError, ValueError):
    """Probabilities cannot be calibrated: one class only, or they rank wrong matches before right ones."""


def fit_sigmoid(score: FloatArray, labels: BoolArray, start: tuple[float, float] | None = None) -> tuple[float, float]:
    """Fit ``P(label) = sigmoid(a * score + b)`` to finite scores by maximum likelihood; return a and b.

    `start`, slope and offset of similar rows for example, saves iterations. Newton's method on Platt's softened targets
    ``(n1 + 1) / (n1 + 2)`` and ``1 / (n0 + 2)``, which keep the slope finite where the scores separate the classes
    (Lin, Lin, Weng, "A note on Platt's probabilistic outputs for support vector machines", 2007). CalibrationError if
    there is one class only, or the best slope is not positive.
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
    if start is not None:
        theta = np.array([start[0] * spread, start[1] + start[0] * middle])
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


def fit_platt(probability: FloatArray, labels: BoolArray) -> tuple[float, float]:
    """Return a and b of ``sigmoid(a * logit(p) + b)``, by `fit_sigmoid` on rows that p was not trained on."""
    return fit_sigmoid(_logit(probability), labels)


def cross_calibrate(probability: FloatArray, labels: BoolArray, fold: IntArray) -> FloatArray:
    """Return out-of-fold probabilities, each calibrated on the other folds' rows, or as they are if those cannot be."""
    result = np.array(probability, np.float64)
    score, start = _logit(probability), None
    for number in np.unique(fold):
        held = fold == number
        with contextlib.suppress(CalibrationError):
            start = fit_sigmoid(score[~held], labels[~held], start)
            result[held] = calibrate(probability[held], *start)
    return result


def _logit(probability: FloatArray) -> FloatArray:
    return np.asarray(logit(np.clip(probability, _CLIP, 1 - _CLIP)))
