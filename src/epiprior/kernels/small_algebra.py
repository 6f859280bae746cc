"""Compiled algebra of small matrices and polynomials, for the solvers: no allocation, no LAPACK."""

from __future__ import annotations

import math

import numba
import numpy as np

_SINGULAR = 1e-10


@numba.njit(cache=True, nogil=True)
def _swap_in_pivot(A, p, rank, order):  # type: ignore[no-untyped-def]
    """Bring the largest of the entries that are left to row and column `p`; return its size."""
    best, row, column = 0.0, p, p
    for r in range(p, rank):
        for c in range(p, 9):
            if abs(A[r, c]) > best:
                best, row, column = abs(A[r, c]), r, c
    for c in range(9):
        A[p, c], A[row, c] = A[row, c], A[p, c]
    for r in range(rank):
        A[r, p], A[r, column] = A[r, column], A[r, p]
    order[p], order[column] = order[column], order[p]
    return best


@numba.njit(cache=True, nogil=True)
def null_space(A, rank, basis):  # type: ignore[no-untyped-def]
    """Eliminate the `rank` x 9 matrix `A` in place, with full pivoting; write a basis of its null space.

    `basis` has shape (9 - rank, 9). Returns False where the rows are dependent.
    """
    order = np.arange(9)
    largest = 0.0
    for p in range(rank):
        size = _swap_in_pivot(A, p, rank, order)
        largest = max(largest, size)
        if size <= _SINGULAR * largest:
            return False
        inverse = 1.0 / A[p, p]
        for c in range(p, 9):
            A[p, c] *= inverse
        for r in range(rank):
            if r != p:
                factor = A[r, p]
                for c in range(p, 9):
                    A[r, c] -= factor * A[p, c]
    for k in range(9 - rank):
        for c in range(rank, 9):
            basis[k, order[c]] = 1.0 if c == rank + k else 0.0
        for r in range(rank):
            basis[k, order[r]] = -A[r, rank + k]
    return True


@numba.njit(cache=True, nogil=True)
def det3(M):  # type: ignore[no-untyped-def]
    """Return the determinant of nine numbers read as a 3 x 3 matrix."""
    return M[0] * (M[4] * M[8] - M[5] * M[7]) - M[1] * (M[3] * M[8] - M[5] * M[6]) + M[2] * (M[3] * M[7] - M[4] * M[6])


@numba.njit(cache=True, nogil=True)
def mixed_det3(A, B):  # type: ignore[no-untyped-def]
    """Return the derivative of det(A + t B) at t = 0: the sum of B times the cofactors of A."""
    return (
        B[0] * (A[4] * A[8] - A[5] * A[7])
        + B[1] * (A[5] * A[6] - A[3] * A[8])
        + B[2] * (A[3] * A[7] - A[4] * A[6])
        + B[3] * (A[2] * A[7] - A[1] * A[8])
        + B[4] * (A[0] * A[8] - A[2] * A[6])
        + B[5] * (A[1] * A[6] - A[0] * A[7])
        + B[6] * (A[1] * A[5] - A[2] * A[4])
        + B[7] * (A[2] * A[3] - A[0] * A[5])
        + B[8] * (A[0] * A[4] - A[1] * A[3])
    )


@numba.njit(cache=True, nogil=True)
def real_roots(c0, c1, c2, c3, roots):  # type: ignore[no-untyped-def]
    """Write the real roots of ``c0 + c1 t + c2 t^2 + c3 t^3`` to `roots`, shape (3,); return how many there are."""
    size = max(abs(c0), abs(c1), abs(c2), abs(c3))
    if abs(c3) <= 1e-14 * size:
        return 0
    a, b, c = c2 / c3, c1 / c3, c0 / c3
    q = (a * a - 3.0 * b) / 9.0
    r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0
    if r * r < q * q * q:
        angle = math.acos(max(-1.0, min(1.0, r / math.sqrt(q * q * q))))
        for k in range(3):
            roots[k] = -2.0 * math.sqrt(q) * math.cos((angle + 2.0 * math.pi * (k - 1)) / 3.0) - a / 3.0
        count = 3
    else:
        w = (abs(r) + math.sqrt(max(r * r - q * q * q, 0.0))) ** (1.0 / 3.0)
        if r > 0:
            w = -w
        roots[0] = w + (q / w if w != 0.0 else 0.0) - a / 3.0
        count = 1
    for k in range(count):
        for _ in range(2):  # the closed form loses digits where roots are close
            t = roots[k]
            slope = (3.0 * t + 2.0 * a) * t + b
            if slope != 0.0:
                step = (((t + a) * t + b) * t + c) / slope
                if abs(step) < 0.1 * (1.0 + abs(t)):
                    roots[k] = t - step
    return count


@numba.njit(cache=True, nogil=True)
def copy_matrix(source, target):  # type: ignore[no-untyped-def]
    """Copy a 3 x 3 matrix; an assignment of slices would take seconds more to compile."""
    for i in range(3):
        for j in range(3):
            target[i, j] = source[i, j]


@numba.njit(cache=True, nogil=True)
def scale_to_unit(F):  # type: ignore[no-untyped-def]
    """Divide `F` by its Frobenius norm in place; return False where that is zero or not finite."""
    norm = 0.0
    for i in range(3):
        for j in range(3):
            norm += F[i, j] * F[i, j]
    norm = math.sqrt(norm)
    if not 0.0 < norm < np.inf:
        return False
    for i in range(3):
        for j in range(3):
            F[i, j] /= norm
    return True


@numba.njit(cache=True, nogil=True)
def smallest_eigenvector3(M, v):  # type: ignore[no-untyped-def]
    """Write a unit eigenvector of the smallest, simple eigenvalue of the symmetric 3 x 3 matrix `M` to `v`."""
    mean = (M[0, 0] + M[1, 1] + M[2, 2]) / 3.0
    off = M[0, 1] ** 2 + M[0, 2] ** 2 + M[1, 2] ** 2
    spread = (M[0, 0] - mean) ** 2 + (M[1, 1] - mean) ** 2 + (M[2, 2] - mean) ** 2 + 2.0 * off
    p = math.sqrt(spread / 6.0)
    if p <= 0.0:
        v[0], v[1], v[2] = 0.0, 0.0, 1.0
        return
    a, b, c = (M[0, 0] - mean) / p, (M[1, 1] - mean) / p, (M[2, 2] - mean) / p
    d, e, f = M[0, 1] / p, M[0, 2] / p, M[1, 2] / p
    half_det = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2.0
    angle = math.acos(max(-1.0, min(1.0, half_det))) / 3.0
    value = 2.0 * math.cos(angle + 2.0 * math.pi / 3.0)
    a, b, c = a - value, b - value, c - value
    # The eigenvector is at right angles to every row of M - value I: the longest of their cross products.
    x0, y0, z0 = d * f - e * b, e * d - a * f, a * b - d * d
    x1, y1, z1 = d * c - e * f, e * e - a * c, a * f - d * e
    x2, y2, z2 = b * c - f * f, f * e - d * c, d * f - b * e
    n0, n1, n2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if n1 > n0:
        x0, y0, z0, n0 = x1, y1, z1, n1
    if n2 > n0:
        x0, y0, z0, n0 = x2, y2, z2, n2
    if n0 <= 0.0:
        v[0], v[1], v[2] = 0.0, 0.0, 1.0
        return
    n = math.sqrt(n0)
    v[0], v[1], v[2] = x0 / n, y0 / n, z0 / n


@numba.njit(cache=True, nogil=True)
def epipoles(F, right, left):  # type: ignore[no-untyped-def]
    """Write unit vectors nearest to ``F right = 0`` and ``left' F = 0``."""
    M = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            M[i, j] = F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j]
    smallest_eigenvector3(M, right)
    for i in range(3):
        for j in range(3):
            M[i, j] = F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2]
    smallest_eigenvector3(M, left)


@numba.njit(cache=True, nogil=True)
def make_rank_two(F):  # type: ignore[no-untyped-def]
    """Replace `F` by the closest matrix of rank 2 and unit norm; return False where there is none."""
    if not scale_to_unit(F):
        return False
    right, left = np.empty(3), np.empty(3)
    epipoles(F, right, left)
    for i in range(3):
        dot = F[i, 0] * right[0] + F[i, 1] * right[1] + F[i, 2] * right[2]
        for j in range(3):
            F[i, j] -= dot * right[j]
    return scale_to_unit(F)
