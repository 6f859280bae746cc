"""Does anything decide F? Planar scenes, pure rotations, points on a line, identical images.

A plane fixes F up to its epipole: every ``F = [e']x H`` explains the matches on it, and the two free numbers
of the epipole are then fitted to whatever outliers lie about. Every estimator returns such an F with
confidence and support.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import bdtrc

from epiprior.chance import beyond_chance, chance_rate, distinct_count
from epiprior.geometry import sampson_distance
from epiprior.types import BoolArray, FloatArray

_MATCHES_PER_EPIPOLE = 2
_MATCHES_BESIDE_LINE = 4
_DECIDED_LEVEL = 0.02
_PARALLAX_LEVEL = 1e-4
_NOTHING_MOVED_PX = 1e-3


def why_degenerate(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    *,
    threshold_px: float = 1.5,
    plane_threshold_px: float | None = None,
    rate: float | None = None,
) -> str:
    """Say why the inliers leave F undecided; an empty string if they decide it.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        The estimate.
    x1, x2 : ndarray, shape (N, 2), float64
        All the matches that F was estimated from, inliers and outliers, pixels.
    threshold_px : float
        Inlier threshold on the Sampson distance.
    plane_threshold_px : float, optional
        How far from the homography a match may lie and still be of the plane; 8/3 of `threshold_px` by
        default, that is 4 px at 1.5 px. At the threshold of F itself, matches that are merely inaccurate
        would count as off the plane (COLMAP tells planes at 4 px and not at 1.5 px, measured; USAC 1.0 uses
        6.5 px).
    rate : float, optional
        `chance_rate` of these arguments, where it is known already.

    Returns
    -------
    str
        ``""``, or a reason for a reader: identical images, points on a line, or one homography.

    Notes
    -----
    The plane's homography is fitted robustly to the inliers of F. F is held to be decided if either

    - more inliers lie off the plane than chance gives: two matches off the plane fix the epipole, the others
      have to fall on its epipolar lines. Their number is held against the best of all pairs of off-plane
      matches under the binomial law, the rate measured on the pair itself (`epiprior.chance`), at a level of 0.02: of 6
      photographed matches off a plane 3 met in an epipole, which is no proof. With 100 outliers it takes about 8
      matches off the plane, with 1,000 about 21; or
    - of the matches near the plane more have a long residual along the epipolar line than across it: longer
      than three standard deviations across, and more of them than a fair coin gives at 1e-4. Noise and
      outliers have no such direction; shallow relief, whose parallax stays below the plane's threshold, has.

    Points on one line, in either image, are treated likewise: the line's matches fix at most three of F's
    seven parameters, so more than four matches beside it are needed than chance gives.

    References
    ----------
    Hartley and Zisserman, section 11.1.2 (degenerate configurations); Chum, Werner and Matas, Two-view
    geometry estimation unaffected by a dominant plane, CVPR 2005.
    """
    plane_px = plane_threshold_px if plane_threshold_px is not None else threshold_px * 8.0 / 3.0
    rate = chance_rate(F, x1, x2, threshold_px) if rate is None else rate
    inliers = sampson_distance(F, x1, x2) < threshold_px
    y1, y2 = x1[inliers], x2[inliers]
    if not len(y1) or np.mean(np.abs(y1 - y2).max(axis=1) < _NOTHING_MOVED_PX) > 0.5:
        return "nothing moved between the images: they are identical, or the camera stood still"
    for name, x in (("1", x1), ("2", x2)):
        beside = ~_near_line(x, x[inliers], plane_px)
        if not _decided_by(x1, x2, inliers, beside, rate=rate, fitted=_MATCHES_BESIDE_LINE):
            return f"the inliers lie on one line in image {name}"
    H = fit_homography(y1, y2, plane_px)
    off_plane = np.ones(len(x1), np.bool_) if H is None else homography_distance(H, x1, x2) >= plane_px
    if _decided_by(x1, x2, inliers, off_plane, rate=rate, fitted=_MATCHES_PER_EPIPOLE):
        return ""
    if H is None or _parallax(F, H, x1[~off_plane], x2[~off_plane]):
        return ""
    near = inliers & ~off_plane
    return (
        f"one homography explains {np.count_nonzero(near)} of {np.count_nonzero(inliers)} inliers, "
        "and no more lie off it than chance gives: a planar scene or a pure rotation"
    )


def _decided_by(
    x1: FloatArray, x2: FloatArray, inliers: BoolArray, outside: BoolArray, *, rate: float, fitted: int
) -> bool:
    """Return whether more of the matches `outside` the degenerate part agree with F than chance gives."""
    supporters = distinct_count(x1[inliers & outside], x2[inliers & outside])
    return beyond_chance(supporters, distinct_count(x1[outside], x2[outside]), rate, fitted, level=_DECIDED_LEVEL)


def fit_homography(x1: FloatArray, x2: FloatArray, threshold_px: float) -> FloatArray | None:
    """Return the homography with ``x2 ~ H x1`` that most matches agree with, or None; deterministic.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels.
    threshold_px : float
        On `homography_distance`.
    """
    if distinct_count(x1, x2) < 4:
        return None
    params = cv2.UsacParams()
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MSAC
    params.loMethod = cv2.LOCAL_OPTIM_INNER_AND_ITER_LO
    params.threshold = threshold_px
    params.confidence = 0.999
    params.maxIterations = 2_000
    try:
        H, _ = cv2.findHomography(x1, x2, params)
    except cv2.error:
        return None
    for _ in range(3):
        if H is None or H.shape != (3, 3) or not np.isfinite(H).all():
            return None
        near = homography_distance(np.asarray(H, dtype=np.float64), x1, x2) < threshold_px
        if distinct_count(x1[near], x2[near]) <= 4:
            break
        H, _ = cv2.findHomography(x1[near], x2[near], 0)
    return None if H is None or not np.isfinite(H).all() else np.asarray(H, dtype=np.float64)


def homography_distance(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the distance of each match from the homography, pixels: the smaller of both transfer errors.

    The smaller, so that a change of scale between the images does not push matches off the plane; ``inf``
    where a point is mapped behind the camera or to infinity.
    """
    forward = np.linalg.norm(_transfer(H, x1) - x2, axis=1)
    try:
        back: FloatArray = np.linalg.inv(H).astype(np.float64)
    except np.linalg.LinAlgError:
        back = np.full((3, 3), np.nan)
    backward = np.linalg.norm(_transfer(back, x2) - x1, axis=1)
    smaller: FloatArray = np.nan_to_num(np.fmin(forward, backward), nan=np.inf)
    return smaller


def _transfer(H: FloatArray, x: FloatArray) -> FloatArray:
    y = x @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        mapped: FloatArray = y[:, :2] / y[:, 2:]
    return mapped


def _near_line(x: FloatArray, support: FloatArray, threshold_px: float) -> BoolArray:
    """Return which points of `x` lie near the line that most points of `support` lie on, if they do."""
    near = support
    for _ in range(5):
        centre = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov(near - centre, rowvar=False, bias=True))[1][:, 0]
        distance = np.abs((support - centre) @ normal)
        near = support[distance <= max(threshold_px, float(np.median(distance)))]
    beside: BoolArray = np.abs((x - centre) @ normal) < threshold_px
    return beside


def _parallax(F: FloatArray, H: FloatArray, x1: FloatArray, x2: FloatArray) -> bool:
    """Return whether residuals from the plane run along the epipolar lines rather than across them."""
    line = x1 @ F[:, :2].T + F[:, 2]
    norm = np.linalg.norm(line[:, :2], axis=1)
    keep = norm > 0
    if not keep.any():
        return False
    normal = line[keep, :2] / norm[keep, None]
    residual = x2[keep] - _transfer(H, x1[keep])
    across = np.abs((residual * normal).sum(axis=1))
    along = np.abs(residual[:, 0] * normal[:, 1] - residual[:, 1] * normal[:, 0])
    limit = 3.0 * 1.4826 * float(np.median(across))
    long_along, long_across = int(np.count_nonzero(along > limit)), int(np.count_nonzero(across > limit))
    return long_along > 0 and bool(bdtrc(long_along - 1, long_along + long_across, 0.5) < _PARALLAX_LEVEL)
