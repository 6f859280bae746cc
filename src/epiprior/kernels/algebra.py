"""Compiled algebra of small matrices and polynomials, for the solvers: no allocation, no LAPACK."""

import math

import numpy as np

from epiprior.kernels.compilation import compiled

_SINGULAR = 1e-10
_LEAST_STEPS, _MOST_STEPS, _CONVERGED = 8, 60, 1e-12


@compiled
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


@compiled
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


@compiled
def det3(M):  # type: ignore[no-untyped-def]
    """Return the determinant of nine numbers read as a 3 x 3 matrix."""
    return M[0] * (M[4] * M[8] - M[5] * M[7]) - M[1] * (M[3] * M[8] - M[5] * M[6]) + M[2] * (M[3] * M[7] - M[4] * M[6])


@compiled
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


@compiled
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


@compiled
def copy_matrix(source, target):  # type: ignore[no-untyped-def]
    """Copy a 3 x 3 matrix; an assignment of slices would take seconds more to compile."""
    for i in range(3):
        for j in range(3):
            target[i, j] = source[i, j]


@compiled
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


@compiled
def epipoles(F, right, left):  # type: ignore[no-untyped-def]
    """Write unit vectors with ``F right = 0`` and ``left' F = 0``; zeros for an `F` of rank 1.

    Of the cross products of two rows, or columns, of `F` the longest.
    """
    for side in range(2):
        M, v = (F, right) if side == 0 else (F.T, left)
        longest = 0.0
        v[0] = v[1] = v[2] = 0.0
        for i in range(3):
            j = (i + 1) % 3
            a = M[i, 1] * M[j, 2] - M[i, 2] * M[j, 1]
            b = M[i, 2] * M[j, 0] - M[i, 0] * M[j, 2]
            c = M[i, 0] * M[j, 1] - M[i, 1] * M[j, 0]
            length = math.sqrt(a * a + b * b + c * c)
            if length > longest:
                longest = length
                v[0], v[1], v[2] = a / length, b / length, c / length


@compiled
def smallest_vector(A, v):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Turn `v` into a unit eigenvector of the smallest eigenvalue of the symmetric `A`, by inverse iteration.

    `v` must not be at right angles to it. Only the lower triangle of `A` is read.
    """
    n = len(v)
    trace = 0.0
    for i in range(n):
        trace += A[i, i]
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j] + (1e-13 * trace if i == j else 0.0)
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(max(s, 1e-15 * trace))
            else:
                L[i, j] = s / L[j, j]
    before = np.empty(n)
    for step in range(_MOST_STEPS):
        for i in range(n):
            before[i] = s = v[i]
            for k in range(i):
                s -= L[i, k] * v[k]
            v[i] = s / L[i, i]
        for i in range(n - 1, -1, -1):
            s = v[i]
            for k in range(i + 1, n):
                s -= L[k, i] * v[k]
            v[i] = s / L[i, i]
        norm = 0.0
        for i in range(n):
            norm += v[i] * v[i]
        norm = np.sqrt(norm)
        change = 0.0
        for i in range(n):
            v[i] /= norm
            change = max(change, abs(v[i] - before[i]))
        if step >= _LEAST_STEPS - 1 and change < _CONVERGED:
            return


@compiled
def make_rank_two(F):  # type: ignore[no-untyped-def]
    """Take the smallest singular value away, in place: F - (F v) v', v the null direction of F'F."""
    M = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                M[i, j] += F[k, i] * F[k, j]
    v = np.array([0.31, -0.22, 0.17])
    smallest_vector(M, v)
    for i in range(3):
        Fv = F[i, 0] * v[0] + F[i, 1] * v[1] + F[i, 2] * v[2]
        for j in range(3):
            F[i, j] -= Fv * v[j]
