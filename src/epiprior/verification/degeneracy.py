"""Does anything decide F? Planar scenes, pure rotations, points on a line, identical images.

A plane fixes F up to its epipole: every ``F = [e']x H`` explains the matches on it, and the two free numbers of the
epipole are then fitted to whatever outliers lie about. Every estimator returns such an F with confidence and support.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import bdtrc

from epiprior.geometry import sampson_distance
from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.types import BoolArray, FloatArray, IntArray
from epiprior.verification.chance import beyond_chance, chance_rate, distinct_count, expected_by_chance

_MATCHES_PER_EPIPOLE = 2
_MATCHES_BESIDE_LINE = 4
_LINE_LEVEL = 0.02
_NOTHING_MOVED_PX = 1e-3
_SINGULAR = 1e-15


@dataclass(frozen=True, kw_only=True)
class DecidedLevels:
    """When F is held to be decided against a dominant plane; chosen together, see `why_degenerate`."""

    expected: float = 1.0  # fewer random hypotheses are expected to have as many supporters off the plane, > 0
    off_plane_share: float = 0.25  # where more of the inliers lie off the plane, it is no dominant one, and
    expected_above_share: float = 1_000.0  # so many may be expected, > 0
    parallax: float = 1e-5  # noise has residuals that run along the epipolar lines with a lower probability


LEVELS = DecidedLevels()


@dataclass(frozen=True, kw_only=True)
class PlaneEvidence:
    """What speaks against F being one of the many that a plane allows."""

    on_plane: int  # distinct inliers of F on its dominant plane
    off_plane: int  # and off it
    expected: float  # random hypotheses expected to have as many inliers off the plane; ``inf`` below three
    parallax: float  # probability that residuals run along the epipolar lines by chance as often as they do

    def decides(self, levels: DecidedLevels = LEVELS) -> bool:
        """Return whether F is decided."""
        many = self.off_plane > levels.off_plane_share * (self.on_plane + self.off_plane)
        allowed = levels.expected_above_share if many else levels.expected
        return self.expected < allowed or self.parallax < levels.parallax


def why_degenerate(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    *,
    threshold_px: float = 1.5,
    rate: float | None = None,
    levels: DecidedLevels = LEVELS,
) -> str:
    """Say why the inliers leave F undecided, in words for a reader; an empty string if they decide it.

    `x1` and `x2`, shape (N, 2), pixels, are all the matches that F was estimated from; `rate` is their `chance_rate`,
    where it is known already; `threshold_px` is meant for the Sampson distance.

    The plane's homography is fitted robustly to the inliers of F; a match is of the plane up to 8/3 of the threshold,
    since at the threshold itself matches that are merely inaccurate would count as off it. F is decided if either

    - more inliers lie off the plane than chance gives: two matches off the plane fix the epipole, the others have to
      fall on its epipolar lines. Their number is held against the best of all pairs of off-plane matches
      (`epiprior.verification.chance`). How likely one agrees by chance depends on how far it lies off the plane: a
      match 5 px off in any direction stays within 2 px of the line through its place on the plane with probability
      0.26, a random match with about 0.01. A feature with a match on the plane has no other; or
    - of the matches near the plane more have a long residual along the epipolar line than across it: longer than three
      standard deviations across, and more of them than a fair coin gives. Noise and outliers have no such direction;
      shallow relief, whose parallax stays below the plane's threshold, has.

    Points on one line, in either image, are treated likewise: the line's matches fix at most three of F's seven
    parameters, so more than four matches beside it are needed than chance gives.

    The levels were chosen by ``benchmarks/verdict.py`` on rendered pairs and on photographs warped as a plane or a
    turning camera sees them: 0.7 % of the right F are turned down, 78 % of planes and rotations are seen (93 % without
    photographs that repeat along rows: their wrong matches agree with one epipole, which is not seen). On real
    photographs 38 of 494 F with an error below 10 px are turned down; 24 of these have a wrong epipole, which control
    points on the plane do not show. Walls whose relief shifts few matches by a few pixels are turned down wrongly.

    References: Hartley and Zisserman, section 11.1.2 (degenerate configurations); Chum, Werner and Matas, Two-view
    geometry estimation unaffected by a dominant plane, CVPR 2005.
    """
    plane_px = threshold_px * 8.0 / 3.0
    rate = chance_rate(F, x1, x2, threshold_px) if rate is None else rate
    inliers = sampson_distance(F, x1, x2) < threshold_px
    y1, y2 = x1[inliers], x2[inliers]
    if not len(y1) or np.mean(np.abs(y1 - y2).max(axis=1) < _NOTHING_MOVED_PX) > 0.5:
        return "nothing moved between the images: they are identical, or the camera stood still"
    for name, x in (("1", x1), ("2", x2)):
        beside = ~_near_line(x, x[inliers], plane_px)
        supporters = distinct_count(x1[inliers & beside], x2[inliers & beside])
        matches = distinct_count(x1[beside], x2[beside])
        if not beyond_chance(supporters, matches, rate, _MATCHES_BESIDE_LINE, level=_LINE_LEVEL):
            return f"the inliers lie on one line in image {name}"
    found = plane_evidence(F, x1, x2, threshold_px=threshold_px, plane_px=plane_px, rate=rate)
    if found is None or found.decides(levels):
        return ""
    return (
        f"one homography explains {found.on_plane} of {found.on_plane + found.off_plane} inliers, "
        "and no more lie off it than chance gives: a planar scene or a pure rotation"
    )


def plane_evidence(
    F: FloatArray, x1: FloatArray, x2: FloatArray, *, threshold_px: float, plane_px: float, rate: float
) -> PlaneEvidence | None:
    """Return what speaks against F being one of the many that its dominant plane allows; None without a plane.

    Arguments as for `why_degenerate`; a match lies off the plane from `plane_px` on.
    """
    inliers = sampson_distance(F, x1, x2) < threshold_px
    H = fit_homography(x1[inliers], x2[inliers], plane_px)
    if H is None or abs(np.linalg.det(H / np.linalg.norm(H))) < _SINGULAR:
        return None
    distance = homography_distance(H, x1, x2)
    near = distance < plane_px
    # Nearest to the plane first: what a feature has on the plane speaks for it, not what else it was matched with.
    order = np.argsort(distance, kind="stable")
    once = order[one_to_one_mask(_point_numbers(x1)[order], _point_numbers(x2)[order])]
    off = once[~near[once]]
    back: FloatArray = np.linalg.inv(H).astype(np.float64)
    agreement = np.maximum(
        _agreement_by_chance(F, H, x1[off], x2[off], threshold_px),
        _agreement_by_chance(F.T, back, x2[off], x1[off], threshold_px),
    )
    return PlaneEvidence(
        on_plane=distinct_count(x1[inliers & near], x2[inliers & near]),
        off_plane=int(np.count_nonzero(inliers[off])),
        expected=expected_by_chance(inliers[off], np.maximum(agreement, rate), _MATCHES_PER_EPIPOLE),
        parallax=_parallax(F, H, x1[near], x2[near]),
    )


def _point_numbers(x: FloatArray) -> IntArray:
    """Return a number for each point, the same for points at the same place."""
    return np.asarray(np.unique(x[:, 0] + 1j * x[:, 1], return_inverse=True)[1], dtype=np.int64)


def _agreement_by_chance(
    F: FloatArray, H: FloatArray, x1: FloatArray, x2: FloatArray, threshold_px: float
) -> FloatArray:
    """Return how likely each match agrees with F if it lies as far from its place on the plane in any direction."""
    place = _transfer(H, x1)
    line2, line1 = x1 @ F[:, :2].T + F[:, 2], x2 @ F[:2] + F[2]
    steep2, steep1 = (np.linalg.norm(line[:, :2], axis=1) for line in (line2, line1))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = threshold_px * np.hypot(steep1, steep2) / steep2  # a Sampson threshold as a distance from the line
        off_line = ((place * line2[:, :2]).sum(axis=1) + line2[:, 2]) / steep2
        length = np.linalg.norm(x2 - place, axis=1)
        ends = [np.arcsin(np.clip((end - off_line) / length, -1.0, 1.0)) for end in (reach, -reach)]
    return np.asarray(np.nan_to_num((ends[0] - ends[1]) / np.pi, nan=1.0))


def fit_homography(x1: FloatArray, x2: FloatArray, threshold_px: float) -> FloatArray | None:
    """Return the homography with ``x2 ~ H x1`` that most matches agree with, or None; deterministic.

    A match agrees where its `homography_distance` is below `threshold_px`.
    """
    if _at_most(3, x1, x2):
        return None
    params = cv2.UsacParams()
    params.sampler, params.score = cv2.SAMPLING_UNIFORM, cv2.SCORE_METHOD_MSAC
    params.loMethod = cv2.LOCAL_OPTIM_INNER_AND_ITER_LO
    params.threshold, params.confidence, params.maxIterations = threshold_px, 0.999, 2_000
    try:
        H, _ = cv2.findHomography(x1, x2, params)
    except cv2.error:
        return None
    before = np.zeros(len(x1), np.bool_)
    for _ in range(3):
        if H is None or H.shape != (3, 3) or not np.isfinite(H).all():
            return None
        near = homography_distance(np.asarray(H, dtype=np.float64), x1, x2) < threshold_px
        if np.array_equal(before, near) or _at_most(4, x1[near], x2[near]):
            break
        before = near
        H, _ = cv2.findHomography(x1[near], x2[near], 0)
    return None if H is None or not np.isfinite(H).all() else np.asarray(H, dtype=np.float64)


def _at_most(count: int, x1: FloatArray, x2: FloatArray) -> bool:
    """Return whether no more matches are distinct; the first hundred, which have fewer, mostly tell."""
    return all(distinct_count(x1[:some], x2[:some]) <= count for some in (100, len(x1)))


def homography_distance(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the distance of each match from the homography, pixels: the smaller of both transfer errors.

    The smaller, so that a change of scale between the images does not push matches off the plane; ``inf`` where a point
    is mapped behind the camera or to infinity.
    """
    forward = np.linalg.norm(_transfer(H, x1) - x2, axis=1)
    try:
        back: FloatArray = np.linalg.inv(H).astype(np.float64)
    except np.linalg.LinAlgError:
        back = np.full((3, 3), np.nan)
    backward = np.linalg.norm(_transfer(back, x2) - x1, axis=1)
    return np.asarray(np.nan_to_num(np.fmin(forward, backward), nan=np.inf))


def _transfer(H: FloatArray, x: FloatArray) -> FloatArray:
    y = x @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(y[:, :2] / y[:, 2:])


def _near_line(x: FloatArray, support: FloatArray, threshold_px: float) -> BoolArray:
    """Return which points of `x` lie near the line that most points of `support` lie on, if they do."""
    u, v = np.ascontiguousarray(support.T)
    middle = (len(support) - 1) // 2, len(support) // 2
    near = np.ones(len(support), np.bool_)
    for _ in range(5):
        centre = support[near].mean(axis=0)
        across = _smallest_spread(u[near] - centre[0], v[near] - centre[1])
        distance = np.abs((u - centre[0]) * across[0] + (v - centre[1]) * across[1])
        # np.median, without what makes it slow on a few hundred numbers.
        median = float(np.partition(distance, middle)[list(middle)].mean())
        before, near = near, distance <= max(threshold_px, median)
        if np.array_equal(before, near):
            break
    return np.asarray(np.abs((x[:, 0] - centre[0]) * across[0] + (x[:, 1] - centre[1]) * across[1]) < threshold_px)


def _smallest_spread(u: FloatArray, v: FloatArray) -> tuple[float, float]:
    """Return the direction, of length one, along which centred points vary least: an eigenvector in closed form."""
    angle = 0.5 * math.atan2(-2.0 * float(u @ v), float(v @ v) - float(u @ u))
    return math.cos(angle), math.sin(angle)


def _parallax(F: FloatArray, H: FloatArray, x1: FloatArray, x2: FloatArray) -> float:
    """Return how likely residuals from the plane run along the epipolar lines as often as they do, by chance."""
    line = x1 @ F[:, :2].T + F[:, 2]
    norm = np.linalg.norm(line[:, :2], axis=1)
    keep = norm > 0
    if not keep.any():
        return 1.0
    normal = line[keep, :2] / norm[keep, None]
    residual = x2[keep] - _transfer(H, x1[keep])
    across = np.abs((residual * normal).sum(axis=1))
    along = np.abs(residual[:, 0] * normal[:, 1] - residual[:, 1] * normal[:, 0])
    limit = 3.0 * 1.4826 * float(np.median(across))
    long_along, long_across = int(np.count_nonzero(along > limit)), int(np.count_nonzero(across > limit))
    return float(bdtrc(long_along - 1, long_along + long_across, 0.5)) if long_along else 1.0
