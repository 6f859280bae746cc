"""Homographies between two images of a plane, or from one point: ``x2 ~ H x1``; points are (N, 2) float64 pixels."""

import numpy as np

from epiprior.types import FloatArray

_SMALLEST_SINGULAR = 1e-12


def normalise_homography(H: FloatArray) -> FloatArray | None:
    """Return `H` with Frobenius norm 1 and positive determinant; None where it is singular or not finite."""
    if H.shape != (3, 3) or not np.isfinite(H).all():
        return None
    values = np.linalg.svd(H, compute_uv=False)
    if values[2] <= _SMALLEST_SINGULAR * values[0]:
        return None
    H = H / np.linalg.norm(H)
    return H if np.linalg.det(H) > 0 else -H


def transfer(H: FloatArray, x: FloatArray) -> FloatArray:
    """Return where `H` takes points (N, 2); NaN where that is at infinity."""
    mapped = np.column_stack([x, np.ones(len(x))]) @ H.T
    w = np.where(np.abs(mapped[:, 2]) > 0, mapped[:, 2], np.nan)
    return np.asarray(mapped[:, :2] / w[:, None])


def transfer_distance(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the larger of both transfer errors of each match, shape (N,), pixels; inf where one is undefined.

    Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 4.2.2, sum the squares of both.
    """
    forward = np.linalg.norm(transfer(H, x1) - x2, axis=1)
    backward = np.linalg.norm(transfer(np.asarray(np.linalg.inv(H)), x2) - x1, axis=1)
    return np.asarray(np.nan_to_num(np.maximum(forward, backward), nan=np.inf))


def grid_in_both(H: FloatArray, size1: tuple[int, int], size2: tuple[int, int]) -> FloatArray:
    """Return those points (N, 2) of a grid over image 1 that `H` takes into image 2; sizes are (width, height)."""
    x, y = (axis.ravel() for axis in np.meshgrid(*((np.arange(12) + 0.5) / 12 * side - 0.5 for side in size1)))
    x1 = np.column_stack([x, y])
    # One sign of the third coordinate is in front; the middle of image 1 decides which.
    front = np.sign(H[2] @ [(size1[0] - 1) / 2, (size1[1] - 1) / 2, 1.0])
    seen = front * (x1 @ H[2, :2] + H[2, 2]) > 0
    x2 = transfer(H, x1)
    inside = ((x2 >= 0) & (x2 <= np.array(size2) - 1.0)).all(axis=1)
    return np.asarray(x1[seen & inside])
