"""The F of a few points clicked by hand, and which of them contradict the others.

A wrong click among few points draws a least-squares fit to itself, so that its residual is small. So F is sought on
subsets of eight; the points that agree with the best of them are fitted as the study fits control points.
"""

from dataclasses import dataclass

import numpy as np

from epiprior.geometry import MIN_MATCHES, as_points, eight_point, refine_fundamental, sampson_distance
from epiprior.types import BoolArray, FloatArray
from epiprior.verification.degeneracy import fit_homography, homography_distance
from epiprior_lab.labels.ground_truth import fit_to_points

MIN_JUDGED = 12
"""Least number of pairs for one to be called far off: with fewer, F fits a wrong one and others are far off."""

_SAMPLES = 150
_REFINED = 3
_SHRINKING = (8.0, 6.0, 4.0, 3.0, 3.0)
_FAR_CLICKS = 3.0
_FAR_MEDIANS = 6.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFit:
    """What the points say about the pair: `F` of those that agree, and Sampson distances (N,), pixels, of all.

    `far_off` (N,) tells which contradict the others, none below `MIN_JUDGED` points; `one_plane` that one homography
    explains all that are not far off: F is then one of many that do.
    """

    F: FloatArray
    residuals: FloatArray
    far_off: BoolArray
    one_plane: bool


def fit_pairs(x1: FloatArray, x2: FloatArray, *, click_px: float = 1.0) -> PairFit | None:
    """Fit F to points (N, 2) clicked by hand, with a precision of `click_px` pixels; FeatureError for other shapes.

    None for fewer than eight points, or where they decide nothing (all on one line, or on one place). A point is far
    off where its distance is above both 3 `click_px` and 6 times the median distance. This is a hint, no proof: where
    nearly all points lie on one plane, a wrong one looks like a point off it, and makes another one far off.
    """
    x1, x2 = as_points("x1", x1), as_points("x2", x2)
    agreeing = np.ones(len(x1), dtype=bool)
    if len(x1) >= MIN_JUDGED:
        agreeing = _agreeing(x1, x2, click_px)
    F = fit_to_points(x1[agreeing], x2[agreeing])
    if F is None:
        return None
    residuals = sampson_distance(F, x1, x2)
    far_off = residuals > _limit(residuals, click_px) if len(x1) >= MIN_JUDGED else ~agreeing
    near1, near2 = x1[~far_off], x2[~far_off]
    H = fit_homography(near1, near2, _FAR_CLICKS * click_px)
    one_plane = H is not None and bool((homography_distance(H, near1, near2) < _FAR_CLICKS * click_px).all())
    return PairFit(F=F, residuals=residuals, far_off=far_off, one_plane=one_plane)


def _limit(residuals: FloatArray, click_px: float) -> float:
    return max(_FAR_CLICKS * click_px, _FAR_MEDIANS * float(np.median(residuals)))


def _agreeing(x1: FloatArray, x2: FloatArray, click_px: float) -> BoolArray:
    """Return which points agree with the best of the fits to all and to subsets of eight, refined; at least eight."""
    cut = _FAR_CLICKS * click_px

    def cost(F: FloatArray) -> float:
        return float(np.square(np.minimum(sampson_distance(F, x1, x2) / cut, 1.0)).sum())

    rng = np.random.default_rng(0)
    subsets = [np.arange(len(x1)), *(rng.choice(len(x1), MIN_MATCHES, replace=False) for _ in range(_SAMPLES))]
    fits = [F for F in (eight_point(x1[subset], x2[subset]) for subset in subsets) if F is not None]
    best = sorted(fits, key=cost)[:_REFINED]
    thresholds = [factor * click_px for factor in _SHRINKING]
    best += [refine_fundamental(F, x1, x2, thresholds=thresholds, score_threshold_px=cut) for F in best]
    if not best:
        return np.ones(len(x1), dtype=bool)
    residuals = sampson_distance(min(best, key=cost), x1, x2)
    agreeing: BoolArray = residuals <= max(_limit(residuals, click_px), float(np.sort(residuals)[MIN_MATCHES - 1]))
    return agreeing
