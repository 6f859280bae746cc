"""Does anything decide F? What a homography explains of the matches, and what is left for F.

A plane fixes F up to its epipole: every ``F = [e']x H`` explains the matches on it, and the two free numbers of the
epipole are then fitted to whatever outliers lie about. Every estimator returns such an F with full support. Whether the
scene is flat, the camera only turned, or the two images are copies of one, is asked here of the matches; what the
answers mean together is learnt (`epiprior.verification.confidence`).

References: Hartley and Zisserman, section 11.1.2 (degenerate configurations); Chum, Werner and Matas, Two-view geometry
estimation unaffected by a dominant plane, CVPR 2005.
"""

import math

import cv2
import numpy as np
from scipy.special import bdtrc

from epiprior.geometry import sampson_distance
from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.types import FloatArray, Geometry, ImageSizes, IntArray
from epiprior.verification.chance import distinct_count, expected_by_chance
from epiprior.verification.measures import FOCAL_LENGTHS, intrinsics

PLANE_FACTOR = 8.0 / 3.0  # a match is of the plane up to so many thresholds: many are merely inaccurate
_MATCHES_PER_EPIPOLE = 2
_SINGULAR = 1e-15
_LEAST_NOISE_PX = 0.25  # features are located no better; without it the parallax of copies would be the last bits'
_COPY_MEDIAN_PX, _COPY_MOST_PX = 0.5, 2.0
_TURN_RATIO = 0.97


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
    if H is None or not np.isfinite(H).all():
        return None
    scaled: FloatArray = np.asarray(H, dtype=np.float64) / float(np.linalg.norm(H))
    return None if abs(np.linalg.det(scaled)) < _SINGULAR else scaled


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


def off_plane_evidence(
    F: FloatArray, H: FloatArray, x1: FloatArray, x2: FloatArray, *, threshold_px: float, rate: float
) -> tuple[int, float]:
    """Return how many inliers of F lie off its plane, and how many random hypotheses are expected to have as many.

    `x1` and `x2`, shape (N, 2), are all matches, `rate` is their `chance_rate`. Two matches off the plane fix the
    epipole, the others have to fall on its epipolar lines. How likely one agrees by chance depends on how far it lies
    off the plane: a match 5 px off in any direction stays within 2 px of the line through its place on the plane with
    probability 0.26, a random match with about 0.01. A feature with a match on the plane has no other.
    """
    inliers = sampson_distance(F, x1, x2) < threshold_px
    distance = homography_distance(H, x1, x2)
    # Nearest to the plane first: what a feature has on the plane speaks for it, not what else it was matched with.
    order = np.argsort(distance, kind="stable")
    once = order[one_to_one_mask(_point_numbers(x1)[order], _point_numbers(x2)[order])]
    off = once[distance[once] >= PLANE_FACTOR * threshold_px]
    back: FloatArray = np.linalg.inv(H).astype(np.float64)
    agreement = np.maximum(
        _agreement_by_chance(F, H, x1[off], x2[off], threshold_px),
        _agreement_by_chance(F.T, back, x2[off], x1[off], threshold_px),
    )
    expected = expected_by_chance(inliers[off], np.maximum(agreement, rate), _MATCHES_PER_EPIPOLE)
    return int(np.count_nonzero(inliers[off])), expected


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


def parallax_by_chance(F: FloatArray, H: FloatArray, x1: FloatArray, x2: FloatArray) -> float:
    """Return how likely residuals from the plane run along the epipolar lines as often as they do, by chance.

    Of matches near the plane those count that have a residual longer than three standard deviations across the lines,
    of 0.25 px at least: noise and outliers have no direction; shallow relief has.
    """
    line = x1 @ F[:, :2].T + F[:, 2]
    norm = np.linalg.norm(line[:, :2], axis=1)
    keep = norm > 0
    if not keep.any():
        return 1.0
    normal = line[keep, :2] / norm[keep, None]
    residual = x2[keep] - _transfer(H, x1[keep])
    across = np.abs((residual * normal).sum(axis=1))
    along = np.abs(residual[:, 0] * normal[:, 1] - residual[:, 1] * normal[:, 0])
    limit = 3.0 * max(1.4826 * float(np.median(across)), _LEAST_NOISE_PX)
    long_along, long_across = int(np.count_nonzero(along > limit)), int(np.count_nonzero(across > limit))
    return float(bdtrc(long_along - 1, long_along + long_across, 0.5)) if long_along else 1.0


def share_beside_line(x: FloatArray, threshold_px: float) -> float:
    """Return which share of points (N, 2) lies off the line that most of them lie on, if they do; 0 without points."""
    if not len(x):
        return 0.0
    u, v = np.ascontiguousarray(x.T)
    middle = (len(x) - 1) // 2, len(x) // 2
    near = np.ones(len(x), np.bool_)
    for _ in range(5):
        centre = x[near].mean(axis=0)
        a, b = u[near] - centre[0], v[near] - centre[1]
        angle = 0.5 * math.atan2(-2.0 * float(a @ b), float(b @ b) - float(a @ a))
        across = math.cos(angle), math.sin(angle)  # where they vary least: an eigenvector in closed form
        distance = np.abs((u - centre[0]) * across[0] + (v - centre[1]) * across[1])
        # np.median, without what makes it slow on a few hundred numbers.
        median = float(np.partition(distance, middle)[list(middle)].mean())
        before, near = near, distance <= max(threshold_px, median)
        if np.array_equal(before, near):
            break
    return float(np.mean(~(distance < threshold_px)))


def similarity_residuals(x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the distance of each match, shape (N,), from the best scaling, turn and shift of image 1, pixels."""
    if len(x1) < 2:
        return np.zeros(len(x1))
    z1, z2 = ((x - x.mean(axis=0)) @ np.array([1.0, 1.0j]) for x in (x1, x2))
    size = float(np.sum(np.abs(z1) ** 2))
    return np.asarray(np.abs(z2 - z1 * (np.sum(np.conj(z1) * z2) / size if size > 0 else 0.0)), np.float64)


def turn_likeness(H: FloatArray, image_sizes: ImageSizes | None) -> float:
    """Return how nearly H is that of a camera that only turns or zooms, in [0, 1]; -1 where sizes are unknown.

    The highest ratio of the smallest to the largest singular value of ``inv(K2) H K1`` over focal lengths from 0.6 to
    2.5 times the longer side: 1 for a rotation.
    """
    if image_sizes is None:
        return -1.0
    K1, K2 = (np.stack([intrinsics(size, float(f)) for f in FOCAL_LENGTHS]) for size in image_sizes)
    values = np.linalg.svd(np.linalg.inv(K2)[:, None] @ H @ K1[None], compute_uv=False)
    return float((values[..., 2] / np.maximum(values[..., 0], 1e-300)).max())


def kind_of_homography(H: FloatArray, x1: FloatArray, x2: FloatArray, image_sizes: ImageSizes | None) -> Geometry:
    """Return which kind of scene or motion a homography stands for, by its matches (N, 2).

    Copies of one picture differ by a scaling, a turn and a shift alone: half of the matches keep to that within 0.5 px,
    nine in ten within 2 px. Where a camera moves or turns, perspective shows.
    """
    residuals = similarity_residuals(x1, x2)
    if np.median(residuals) < _COPY_MEDIAN_PX and np.quantile(residuals, 0.9) < _COPY_MOST_PX:
        return Geometry.IDENTICAL
    return Geometry.ROTATION if turn_likeness(H, image_sizes) >= _TURN_RATIO else Geometry.PLANAR
