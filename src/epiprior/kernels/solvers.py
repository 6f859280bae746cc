"""Compiled solvers for F: seven points, weighted matches, two oriented matches.

Matches are columns of an array of shape (4, N); F acts on their coordinates.

References: Hartley and Zisserman, Multiple View Geometry, 2nd ed., 11.1.
"""

import math

import numpy as np

from epiprior.kernels import algebra
from epiprior.kernels.compilation import compiled


@compiled
def fill_row(row, x, y, u, v):  # type: ignore[no-untyped-def]
    """Write the coefficients of ``x2' F x1`` for F read row by row."""
    row[0], row[1], row[2] = u * x, u * y, u
    row[3], row[4], row[5] = v * x, v * y, v
    row[6], row[7], row[8] = x, y, 1.0


@compiled
def seven_point(columns, sample, models):  # type: ignore[no-untyped-def]
    """Write up to three F of rank 2 through seven matches to `models`, shape (3, 3, 3); return how many."""
    A = np.empty((7, 9))
    basis = np.empty((2, 9))
    roots = np.empty(3)
    for k in range(7):
        i = sample[k]
        fill_row(A[k], columns[0, i], columns[1, i], columns[2, i], columns[3, i])
    if not algebra.null_space(A, 7, basis):
        return 0
    G, H = basis[0], basis[1]
    count = algebra.real_roots(
        algebra.det3(G), algebra.mixed_det3(G, H), algebra.mixed_det3(H, G), algebra.det3(H), roots
    )
    found = 0
    for k in range(count):
        for j in range(9):
            models[found, j // 3, j % 3] = G[j] + roots[k] * H[j]
        if algebra.scale_to_unit(models[found]):
            found += 1
    return found


@compiled
def weighted_eight_point(columns, w, F):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Write the normalised, weighted eight-point estimate to `F` (3, 3); False where the points decide nothing.

    Each image is centred and scaled by the weighted matches (Hartley and Zisserman, algorithm 11.1).
    """
    x, y, u, v = columns[0], columns[1], columns[2], columns[3]
    total = a = b = c = d = 0.0
    count = 0
    for m in range(len(w)):
        if w[m] > 0.0:
            count += 1
            total += w[m]
            a += w[m] * x[m]
            b += w[m] * y[m]
            c += w[m] * u[m]
            d += w[m] * v[m]
    if count < 8:
        return False
    a, b, c, d = a / total, b / total, c / total, d / total
    spread1 = spread2 = 0.0
    for m in range(len(w)):
        if w[m] > 0.0:
            spread1 += w[m] * ((x[m] - a) ** 2 + (y[m] - b) ** 2)
            spread2 += w[m] * ((u[m] - c) ** 2 + (v[m] - d) ** 2)
    if not spread1 > 1e-12 * total or not spread2 > 1e-12 * total:
        return False
    f1, f2 = np.sqrt(2.0 * total / spread1), np.sqrt(2.0 * total / spread2)
    A = np.zeros((9, 9))
    row = np.empty(9)
    for m in range(len(w)):
        if w[m] > 0.0:
            fill_row(row, (x[m] - a) * f1, (y[m] - b) * f1, (u[m] - c) * f2, (v[m] - d) * f2)
            for i in range(9):
                scaled = w[m] * row[i]
                for j in range(i + 1):
                    A[i, j] += scaled * row[j]
    flat = np.array([0.31, -0.22, 0.17, 0.41, 0.13, -0.37, 0.29, 0.47, 0.43])
    algebra.smallest_vector(A, flat)
    f = flat.reshape(3, 3)
    algebra.make_rank_two(f)
    # F = T2' f T1 with T = [[s, 0, -s cx], [0, s, -s cy], [0, 0, 1]].
    for i in range(3):
        f[i, 2] -= f1 * (f[i, 0] * a + f[i, 1] * b)
        f[i, 0] *= f1
        f[i, 1] *= f1
    for j in range(3):
        f[2, j] -= f2 * (f[0, j] * c + f[1, j] * d)
        f[0, j] *= f2
        f[1, j] *= f2
    if not algebra.scale_to_unit(f):
        return False
    algebra.copy_matrix(f, F)
    return True


@compiled
def fit_samples(columns, rows):  # type: ignore[no-untyped-def]
    """Return the eight-point F of each row of `rows` (S, K) into the matches; zero where they decide nothing."""
    models = np.zeros((len(rows), 3, 3))
    size = rows.shape[1]
    points, ones = np.empty((4, size)), np.ones(size)
    for s in range(len(rows)):
        for k in range(size):
            for side in range(4):
                points[side, k] = columns[side, rows[s, k]]
        weighted_eight_point(points, ones, models[s])
    return models


@compiled
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
    return weighted_eight_point(points, np.ones(8), F)
