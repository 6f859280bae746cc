"""Fundamental matrices from points, and Sampson distances.

Conventions: ``x1, x2`` are ``(N, 2)`` float64 pixels; ``x2' F x1 = 0``; residuals are unsquared pixels.
References: Hartley and Zisserman, Multiple View Geometry, 2nd ed., chapter 11 (eight points: 11.2; Sampson: 11.4.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from epiprior.errors import FeatureError
from epiprior.types import Float32Array, FloatArray

MIN_MATCHES = 8


def as_points(name: str, points: ArrayLike) -> FloatArray:
    """Return `points` as a contiguous float64 array of shape (N, 2).

    Raises
    ------
    FeatureError
        If the shape is another, or a value is not finite; the message carries `name`.
    """
    try:
        array = np.ascontiguousarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FeatureError(f"{name} is not an array of numbers: {error}") from error
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        raise FeatureError(f"{name} has shape {array.shape}, expected (N, 2)")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise FeatureError(f"{name} holds a NaN or infinite value, first in row {row}")
    return array


def normalise_fundamental(F: FloatArray) -> FloatArray | None:
    """Return `F` at rank 2, Frobenius norm 1 and with its largest entry positive; None if that cannot be done.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        Any 3 x 3 matrix.

    Returns
    -------
    ndarray, shape (3, 3), or None
        None where `F` has another shape, holds a value that is not finite, or has rank below 2.
    """
    F = np.asarray(F, dtype=np.float64)
    if F.shape != (3, 3) or not np.isfinite(F).all():
        return None
    norm = float(np.linalg.norm(F))
    if norm == 0:
        return None
    U, s, Vt = np.linalg.svd(F / norm)
    if s[1] <= 1e-12 * s[0]:
        return None
    F = (U[:, :2] * s[:2]) @ Vt[:2]
    F /= np.linalg.norm(F)
    return F if F.flat[np.abs(F).argmax()] > 0 else -F


def sampson_distance(F: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the Sampson distance of each match, in pixels.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        Fundamental matrix with ``x2' F x1 = 0``; any non-zero scale.
    x1, x2 : ndarray, shape (N, 2), float64
        Matched points, pixels. ``N = 0`` is allowed.

    Returns
    -------
    ndarray, shape (N,), float64
        >= 0; ``inf`` where both epipolar lines are undefined.

    Raises
    ------
    FeatureError
        If shapes disagree; the message carries them.

    References
    ----------
    Hartley and Zisserman, equation 11.9 (its square).
    """
    if x1.shape != x2.shape or x1.ndim != 2 or x1.shape[1] != 2:
        raise FeatureError(f"x1 and x2 have shapes {x1.shape} and {x2.shape}, expected (N, 2) twice")
    line2 = x1 @ F[:, :2].T + F[:, 2]
    line1 = x2 @ F[:2] + F[2]
    # Column by column: sums along axes of length two take numpy several times as long.
    (a, b, c), (d, e, _) = line2.T, line1.T
    algebraic = x2[:, 0] * a + x2[:, 1] * b + c
    gradient = np.sqrt((a * a + b * b) + (d * d + e * e))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(algebraic) / gradient
    return np.where(gradient > 0, distance, np.inf)


def centred_columns(models: FloatArray, centre1: FloatArray, centre2: FloatArray) -> Float32Array:
    """Return fundamental matrices for points that are centred, as compiled kernels read them in single precision.

    Parameters
    ----------
    models : ndarray, shape (K, 3, 3), float64
        Fundamental matrices for pixels; K = 0 is allowed.
    centre1, centre2 : ndarray, shape (2,), float64
        What is subtracted from the points of both images.

    Returns
    -------
    ndarray, shape (9, K), float32
        Row by row, each matrix at a size at which neither its entries nor its residuals leave single precision.
    """
    T1, T2 = np.eye(3), np.eye(3)
    T1[:2, 2], T2[:2, 2] = centre1, centre2
    G = T2.T @ models @ T1
    size = np.abs(G).max(axis=(1, 2), keepdims=True)
    G /= np.abs(G[:, :2, :2]).max(axis=(1, 2), keepdims=True) + size * 1e-9 + 1e-300
    return np.ascontiguousarray(G.reshape(-1, 9).T, dtype=np.float32)


def _conditioning(x: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weighted, isotropically scaled points (Hartley's normalisation) and the 3 x 3 map that made them."""
    centre = weights @ x / weights.sum()
    u, v = (x - centre).T
    spread = np.sqrt(weights @ (u * u + v * v) / weights.sum())
    factor = np.sqrt(2.0) / max(spread, 1e-9)
    T = np.array([[factor, 0.0, -factor * centre[0]], [0.0, factor, -factor * centre[1]], [0.0, 0.0, 1.0]])
    return (x - centre) * factor, T


def eight_point(x1: FloatArray, x2: FloatArray, weights: FloatArray | None = None) -> FloatArray | None:
    """Return the normalised (weighted) eight-point estimate.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels, N >= 8.
    weights : ndarray, shape (N,), float64, optional
        Non-negative weight of each match's squared algebraic residual.

    Returns
    -------
    ndarray, shape (3, 3), or None
        Normalised as by `normalise_fundamental`; None for fewer than 8 matches of positive weight or where the
        points decide nothing.

    References
    ----------
    Hartley and Zisserman, algorithm 11.1.
    """
    w = np.ones(len(x1)) if weights is None else np.asarray(weights, dtype=np.float64)
    if np.count_nonzero(w > 0) < MIN_MATCHES:
        return None
    n1, T1 = _conditioning(x1, w)
    n2, T2 = _conditioning(x2, w)
    h1 = np.column_stack([n1, np.ones(len(n1))])
    h2 = np.column_stack([n2, np.ones(len(n2))])
    A = (h2[:, :, None] * h1[:, None, :]).reshape(-1, 9)
    _, vectors = np.linalg.eigh((A * w[:, None]).T @ A)
    U, s, Vt = np.linalg.svd(vectors[:, 0].reshape(3, 3))
    return normalise_fundamental(T2.T @ ((U[:, :2] * s[:2]) @ Vt[:2]) @ T1)
