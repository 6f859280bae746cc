"""Compiled solvers for F: seven points, eight points, two oriented matches, many weighted matches.

Matches are columns of an array of shape (4, N), conditioned: centred in each image and divided by one length
common to both, so that Sampson distances keep their meaning. F acts on these coordinates.

References: Hartley and Zisserman, Multiple View Geometry, 2nd ed., 11.1.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from epiprior.kernels.small_algebra import (
    det3,
    make_rank_two,
    mixed_det3,
    null_space,
    real_roots,
    scale_to_unit,
)


@numba.njit(cache=True, nogil=True)
def fill_row(row, x, y, u, v):  # type: ignore[no-untyped-def]
    """Write the coefficients of ``x2' F x1`` for F read row by row."""
    row[0], row[1], row[2] = u * x, u * y, u
    row[3], row[4], row[5] = v * x, v * y, v
    row[6], row[7], row[8] = x, y, 1.0


@numba.njit(cache=True, nogil=True)
def seven_point(columns, sample, models):  # type: ignore[no-untyped-def]
    """Write up to three F of rank 2 through seven matches to `models`, shape (3, 3, 3); return how many."""
    A = np.empty((7, 9))
    basis = np.empty((2, 9))
    roots = np.empty(3)
    for k in range(7):
        i = sample[k]
        fill_row(A[k], columns[0, i], columns[1, i], columns[2, i], columns[3, i])
    if not null_space(A, 7, basis):
        return 0
    G, H = basis[0], basis[1]
    count = real_roots(det3(G), mixed_det3(G, H), mixed_det3(H, G), det3(H), roots)
    found = 0
    for k in range(count):
        for j in range(9):
            models[found, j // 3, j % 3] = G[j] + roots[k] * H[j]
        if scale_to_unit(models[found]):
            found += 1
    return found


@numba.njit(cache=True, nogil=True)
def conditioning(points, weights, shift):  # type: ignore[no-untyped-def]
    """Write the weighted centres of both images to `shift`, shape (4,); return both scaling factors (Hartley)."""
    total = 0.0
    shift[:] = 0.0
    for i in range(points.shape[1]):
        if weights[i] > 0.0:
            total += weights[i]
            for k in range(4):
                shift[k] += weights[i] * points[k, i]
    for k in range(4):
        shift[k] /= total
    spread1, spread2 = 0.0, 0.0
    for i in range(points.shape[1]):
        if weights[i] > 0.0:
            spread1 += weights[i] * ((points[0, i] - shift[0]) ** 2 + (points[1, i] - shift[1]) ** 2)
            spread2 += weights[i] * ((points[2, i] - shift[2]) ** 2 + (points[3, i] - shift[3]) ** 2)
    return math.sqrt(2.0 * total / max(spread1, 1e-18)), math.sqrt(2.0 * total / max(spread2, 1e-18))


@numba.njit(cache=True, nogil=True)
def undo_conditioning(G, shift, factor1, factor2, F):  # type: ignore[no-untyped-def]
    """Write ``T2' G T1`` to `F`, where T shifts by -shift and then scales."""
    H = np.empty((3, 3))
    for i in range(3):
        H[i, 0] = G[i, 0] * factor1
        H[i, 1] = G[i, 1] * factor1
        H[i, 2] = G[i, 2] - factor1 * (G[i, 0] * shift[0] + G[i, 1] * shift[1])
    for j in range(3):
        F[0, j] = H[0, j] * factor2
        F[1, j] = H[1, j] * factor2
        F[2, j] = H[2, j] - factor2 * (H[0, j] * shift[2] + H[1, j] * shift[3])


@numba.njit(cache=True, nogil=True)
def eight_point_exact(points, F):  # type: ignore[no-untyped-def]
    """Write the normalised eight-point F of `points`, shape (4, 8), at rank 2; return whether there is one."""
    A = np.empty((8, 9))
    basis = np.empty((1, 9))
    shift = np.empty(4)
    f1, f2 = conditioning(points, np.ones(8), shift)
    for i in range(8):
        fill_row(
            A[i],
            (points[0, i] - shift[0]) * f1,
            (points[1, i] - shift[1]) * f1,
            (points[2, i] - shift[2]) * f2,
            (points[3, i] - shift[3]) * f2,
        )
    if not null_space(A, 8, basis):
        return False
    G = basis.reshape(3, 3)
    if not make_rank_two(G):
        return False
    undo_conditioning(G, shift, f1, f2, F)
    return scale_to_unit(F)


@numba.njit(cache=True, nogil=True)
def two_oriented(columns, frames, i, j, radius, F):  # type: ignore[no-untyped-def]
    """Write the F of two oriented matches: each gives its location and three points around it (2-SIFT, BEEM-style).

    `frames`, shape (4, N), holds scale in image 1 and 2 (in the unit of `columns`) and orientation in image 1 and 2
    (radians); the three points lie `radius` scales away, at angles theta + 2 pi k / 3.
    """
    points = np.empty((4, 8))
    for part in range(2):
        m = i if part == 0 else j
        for k in range(4):
            q = 4 * part + k
            for side in range(2):
                x, y = columns[2 * side, m], columns[2 * side + 1, m]
                if k > 0:
                    angle = frames[2 + side, m] + 2.0 * math.pi * (k - 1) / 3.0
                    x += radius * frames[side, m] * math.cos(angle)
                    y += radius * frames[side, m] * math.sin(angle)
                points[2 * side, q], points[2 * side + 1, q] = x, y
    return eight_point_exact(points, F)


@numba.njit(cache=True, nogil=True)
def weighted_eight_point(columns, weights, F):  # type: ignore[no-untyped-def]
    """Write the normalised weighted eight-point F at rank 2; return False below eight matches of positive weight."""
    count = 0
    for w in weights:
        count += w > 0.0
    if count < 8:
        return False
    shift = np.empty(4)
    f1, f2 = conditioning(columns, weights, shift)
    row = np.empty(9)
    M = np.zeros((9, 9))
    for i in range(columns.shape[1]):
        w = weights[i]
        if w > 0.0:
            fill_row(
                row,
                (columns[0, i] - shift[0]) * f1,
                (columns[1, i] - shift[1]) * f1,
                (columns[2, i] - shift[2]) * f2,
                (columns[3, i] - shift[3]) * f2,
            )
            for a in range(9):
                for b in range(a + 1):
                    M[a, b] += w * row[a] * row[b]
    for a in range(9):
        for b in range(a):
            M[b, a] = M[a, b]
    if not np.isfinite(M.sum()):
        return False
    _, vectors = np.linalg.eigh(M)
    G = np.ascontiguousarray(vectors[:, 0]).reshape(3, 3)
    if not make_rank_two(G):
        return False
    undo_conditioning(G, shift, f1, f2, F)
    return scale_to_unit(F)
