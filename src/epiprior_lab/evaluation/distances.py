"""Measures of an estimate against the true geometry, beside the paper's: a distance of two F, errors of the pose."""

import numpy as np

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.pairsets import Camera

Size = tuple[int, int]
_DRAWS_PER_POINT = 8  # lines that miss the other image are drawn anew, but not for ever


def symmetric_distance(
    F: FloatArray, true_F: FloatArray, sizes: tuple[Size, Size], *, points: int = 1000, seed: int = 0
) -> float:
    """Return the normalised symmetric geometric distance of two fundamental matrices, in either order.

    A random point of image 1 and a random point on its line under one matrix, where the line crosses image 2, are
    measured by their distances to the epipolar lines of the other matrix; then the matrices change places. `sizes` are
    (width, height), pixels, and `points` is per direction. The mean distance is in shares of an image's diagonal, in
    [0, 1]; 1 where no epipolar line meets the other image. Zhang, Determining the epipolar geometry and its
    uncertainty, IJCV 1998; normalised as in FM-Bench (Bian et al., BMVC 2019).
    """
    rng = np.random.default_rng(seed)
    means = [_one_way(*matrices, sizes, points, rng) for matrices in ((F, true_F), (true_F, F))]
    return min(1.0, sum(means) / 2)


def _one_way(
    F: FloatArray, other: FloatArray, sizes: tuple[Size, Size], points: int, rng: np.random.Generator
) -> float:
    drawn = rng.uniform(0, np.array(sizes[0]) - 1.0, (_DRAWS_PER_POINT * points, 2))
    share = rng.uniform(size=len(drawn))
    on_line, met = points_on_lines(_homogeneous(drawn) @ F.T, sizes[1], share)
    x1, x2 = drawn[met][:points], on_line[met][:points]
    if not len(x1):
        return 1.0
    in_second = _distance(_homogeneous(x1) @ other.T, x2) / np.hypot(*sizes[1])
    in_first = _distance(_homogeneous(x2) @ other, x1) / np.hypot(*sizes[0])
    return float(np.minimum((in_first + in_second) / 2, 1.0).mean())


def points_on_lines(lines: FloatArray, size: Size, share: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return a point of each line inside the image, NaN where there is none, and which lines cross it.

    `lines`, shape (N, 3), are ``a x + b y + c = 0``; the image of `size` (width, height) spans the centres of its
    pixels. `share`, shape (N,), in [0, 1], is the place between the two ends of the part inside the image.
    """
    normal, length = lines[:, :2], np.linalg.norm(lines[:, :2], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = -lines[:, 2:] * normal / (length**2)[:, None]
        along = np.column_stack([-normal[:, 1], normal[:, 0]]) / length[:, None]
        ends = np.stack([(0.0 - foot) / along, (np.array(size) - 1.0 - foot) / along])
        inside = (foot >= 0) & (foot <= np.array(size) - 1.0)
        flat = along == 0
        low = np.where(flat, np.where(inside, -np.inf, np.inf), ends.min(axis=0)).max(axis=1)
        high = np.where(flat, np.where(inside, np.inf, -np.inf), ends.max(axis=0)).min(axis=1)
        met = (length > 0) & (low < high)
        x = foot + (low + share * (high - low))[:, None] * along
    return np.where(met[:, None], x, np.nan), met


def pose_errors(F: FloatArray, cameras: tuple[Camera, Camera], x1: FloatArray, x2: FloatArray) -> tuple[float, float]:
    """Return the errors of rotation and direction of translation, degrees, that F gives with the true calibration.

    `x1`, `x2`, shape (N, 2), pixels, are inliers: of the four poses the one is taken that puts most of them in front of
    both cameras. The errors are in [0, 180] and, since an F knows no sign, in [0, 90]; NaN for the translation where
    the true cameras share their centre. Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 9.6.
    """
    first, second = cameras
    true_R = second.R @ first.R.T
    true_t = second.t - true_R @ first.t
    U, _, Vt = np.linalg.svd(second.K.T @ F @ first.K)
    U, Vt = U * np.sign(np.linalg.det(U)), Vt * np.sign(np.linalg.det(Vt))
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rays1 = _homogeneous(x1) @ np.linalg.inv(first.K).T
    rays2 = _homogeneous(x2) @ np.linalg.inv(second.K).T
    poses: list[tuple[FloatArray, FloatArray]] = [
        (U @ turn @ Vt, sign * U[:, 2]) for turn in (W, W.T) for sign in (1.0, -1.0)
    ]
    R, t = max(poses, key=lambda pose: _in_front(pose[0], pose[1], rays1, rays2))
    cosine = (np.trace(R @ true_R.T) - 1) / 2
    rotation = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    length = float(np.linalg.norm(true_t))
    if not length > 0:
        return rotation, float("nan")
    return rotation, float(np.degrees(np.arccos(np.clip(abs(t @ true_t) / length, 0, 1))))


def _in_front(R: FloatArray, t: FloatArray, rays1: FloatArray, rays2: FloatArray) -> int:
    """Count the points that lie in front of both cameras: ``depth2 ray2 = depth1 R ray1 + t``."""
    turned = rays1 @ R.T
    # Least squares of each pair of rays, by Cramer's rule; only the signs matter.
    a, b, c = (turned**2).sum(axis=1), (turned * rays2).sum(axis=1), (rays2**2).sum(axis=1)
    p, q = turned @ t, rays2 @ t
    depth1, depth2 = b * q - c * p, a * q - b * p
    return int(np.count_nonzero((depth1 > 0) & (depth2 > 0)))


def _homogeneous(x: FloatArray) -> FloatArray:
    return np.column_stack([x, np.ones(len(x))])


def _distance(lines: FloatArray, x: FloatArray) -> FloatArray:
    """Return the distance of each point to its line; infinite where there is no line."""
    length = np.linalg.norm(lines[:, :2], axis=1)
    off = np.abs((lines * _homogeneous(x)).sum(axis=1))
    return np.asarray(np.divide(off, length, out=np.full(len(x), np.inf), where=length > 0))
