"""Refine a fundamental matrix on matches weighted by their probabilities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from epiprior.geometry import MIN_MATCHES, eight_point, sampson_distance
from epiprior.types import FloatArray

SHRINKING_THRESHOLDS_PX = (10.0, 8.0, 6.0, 4.0, 3.0, 2.0, 2.0, 1.5, 1.5)
SCORE_THRESHOLD_PX = 2.0


def weighted_score(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    weights: FloatArray,
    threshold_px: float = SCORE_THRESHOLD_PX,
) -> float:
    """Return the sum of the weights of the matches, each lowered by its squared distance, cut at a threshold.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        Fundamental matrix.
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels.
    weights : ndarray, shape (N,), float64
        Non-negative, for example the probabilities.
    threshold_px : float
        Sampson distance at which a match counts nothing.

    Returns
    -------
    float
        In [0, sum of the weights].
    """
    r = sampson_distance(F, x1, x2) / threshold_px
    return float(weights @ np.maximum(1.0 - r * r, 0.0))


def refine_fundamental(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    weights: FloatArray | None = None,
    thresholds: Sequence[float] = SHRINKING_THRESHOLDS_PX,
    *,
    score_threshold_px: float = SCORE_THRESHOLD_PX,
) -> FloatArray:
    """Return the best F of a series of weighted eight-point fits over shrinking thresholds.

    Each fit takes the matches within the threshold of the F before it, by its weight, lowered towards the
    threshold (Tukey's biweight) and divided by the squared gradient of the residual, so that what is
    minimised is the Sampson distance. The F with the highest `weighted_score` is kept, the first one
    included: the result never scores less than what went in.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        Start; within the first threshold of the truth on most right matches.
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels, one-to-one. N < 8 returns `F`.
    weights : ndarray, shape (N,), float64, optional
        Probability of each match; 1 by default.
    thresholds : sequence of float
        Pixels, from wide to narrow.
    score_threshold_px : float
        Of the score that decides.

    Returns
    -------
    ndarray, shape (3, 3), float64
        Normalised as by `normalise_fundamental`.

    References
    ----------
    Shrinking thresholds: local optimisation of LO-RANSAC (Chum, Matas and Kittler, DAGM 2003) and of USAC.
    Weighing by the probabilities of the matches is ours.
    """
    w = np.ones(len(x1)) if weights is None else np.asarray(weights, dtype=np.float64)
    # Matches that are far off now do not come back; the fits then run on a fraction of the matches.
    near = (sampson_distance(F, x1, x2) < 3.0 * max(thresholds, default=0.0)) & (w > 0)
    if np.count_nonzero(near) < MIN_MATCHES:
        return F
    x1, x2, w = x1[near], x2[near], w[near]
    best, best_score = F, weighted_score(F, x1, x2, w, score_threshold_px)
    current = F
    for threshold in thresholds:
        fitted = eight_point(x1, x2, _fit_weights(current, x1, x2, w, threshold))
        if fitted is None:
            break
        current = fitted
        score = weighted_score(current, x1, x2, w, score_threshold_px)
        if score > best_score:
            best, best_score = current, score
    return best


def _fit_weights(F: FloatArray, x1: FloatArray, x2: FloatArray, w: FloatArray, threshold: float) -> FloatArray:
    """Return the weight of each match's squared algebraic residual in the next fit."""
    a, b = (x1 @ F[:2, :2].T + F[:2, 2]).T
    d, e = (x2 @ F[:2, :2] + F[2, :2]).T
    gradient_sq = (a * a + b * b) + (d * d + e * e)
    r = sampson_distance(F, x1, x2) / threshold
    tukey = np.square(np.maximum(1.0 - r * r, 0.0))
    scale = float(np.median(gradient_sq))
    return w * tukey * (scale / np.maximum(gradient_sq, 1e-6 * scale)) if scale > 0 else w * tukey
