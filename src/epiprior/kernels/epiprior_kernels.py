"""Compiled steps of the estimator ``epiprior``: scores of many F, weighted eight-point fits, local refinement.

Kernels run on one thread, and no sum depends on how the work is cut: the same input gives the same bytes.
"""

from __future__ import annotations

import numba
import numpy as np

from epiprior.kernels.samplers import draw

_CHUNK = 128
_POWER_STEPS = 8


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def score_models(F, x1, x2, weights, group, limit_sq, scores):  # type: ignore[no-untyped-def]
    """Add up, per model, what the matches say for it; `scores` (K,) is written.

    `F` is (9, K); matches are sorted by `group`, and of each group the best counts: w (1 - r^2 / limit_sq). A match for
    whose points `F` has no epipolar lines says nothing; nor does any match for a model of zeros.
    """
    n = len(x1)
    one, none = np.float32(1), np.float32(0)
    best = np.empty(_CHUNK, np.float32)
    for start in range(0, F.shape[1], _CHUNK):
        count = min(_CHUNK, F.shape[1] - start)
        G = F[:, start : start + count]
        total = scores[start : start + count]
        for k in range(count):
            best[k] = total[k] = none
        for m in range(n):
            x, y, u, v, w = x1[m, 0], x1[m, 1], x2[m, 0], x2[m, 1], weights[m]
            for k in range(count):
                l0 = G[0, k] * x + G[1, k] * y + G[2, k]
                l1 = G[3, k] * x + G[4, k] * y + G[5, k]
                l2 = G[6, k] * x + G[7, k] * y + G[8, k]
                r0 = G[0, k] * u + G[3, k] * v + G[6, k]
                r1 = G[1, k] * u + G[4, k] * v + G[7, k]
                e = u * l0 + v * l1 + l2
                square = e * e / (l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1)
                value = w * (one - square / limit_sq)
                best[k] = value if value > best[k] else best[k]
            if m == n - 1 or group[m + 1] != group[m]:
                for k in range(count):
                    total[k] += best[k]
                    best[k] = none


@numba.njit(cache=True, nogil=True)
def _smallest_vector(A, v):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Return the eigenvector of the smallest eigenvalue of the symmetric 9 x 9 matrix `A`, by inverse iteration."""
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
    for _ in range(_POWER_STEPS):
        for i in range(n):
            s = v[i]
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
        for i in range(n):
            v[i] /= norm
    return v


@numba.njit(cache=True, nogil=True)
def _make_rank_two(F):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Take the smallest singular value away, in place: F - (F v) v', v the null direction of F'F."""
    M = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                M[i, j] += F[k, i] * F[k, j]
    # The adjugate of F'F has the same eigenvectors; squared often enough, only that of the smallest value is left.
    P = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            P[i, j] = M[a, c] * M[b, d] - M[a, d] * M[b, c]
    for _ in range(6):
        scale = 0.0
        for i in range(3):
            for j in range(3):
                scale = max(scale, abs(P[i, j]))
        if scale == 0.0:
            return
        Q = np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    Q[i, j] += (P[i, k] / scale) * (P[k, j] / scale)
        P = Q
    column = 0
    for j in range(1, 3):
        if P[j, j] > P[column, column]:
            column = j
    v = P[:, column].copy()
    v /= np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    for i in range(3):
        Fv = F[i, 0] * v[0] + F[i, 1] * v[1] + F[i, 2] * v[2]
        for j in range(3):
            F[i, j] -= Fv * v[j]


@numba.njit(cache=True, nogil=True)
def fit_weighted(x1, x2, w, F):  # type: ignore[no-untyped-def]  # noqa: PLR0912
    """Write the normalised, weighted eight-point estimate to `F` (3, 3); False where the points decide nothing.

    Each image is centred and scaled by the weighted matches (Hartley and Zisserman, algorithm 11.1).
    """
    total = a = b = c = d = 0.0
    count = 0
    for m in range(len(w)):
        if w[m] > 0.0:
            count += 1
            total += w[m]
            a += w[m] * x1[m, 0]
            b += w[m] * x1[m, 1]
            c += w[m] * x2[m, 0]
            d += w[m] * x2[m, 1]
    if count < 8:
        return False
    a, b, c, d = a / total, b / total, c / total, d / total
    spread1 = spread2 = 0.0
    for m in range(len(w)):
        if w[m] > 0.0:
            spread1 += w[m] * ((x1[m, 0] - a) ** 2 + (x1[m, 1] - b) ** 2)
            spread2 += w[m] * ((x2[m, 0] - c) ** 2 + (x2[m, 1] - d) ** 2)
    if not spread1 > 1e-12 * total or not spread2 > 1e-12 * total:
        return False
    f1, f2 = np.sqrt(2.0 * total / spread1), np.sqrt(2.0 * total / spread2)
    A = np.zeros((9, 9))
    row = np.empty(9)
    for m in range(len(w)):
        if w[m] > 0.0:
            x, y = (x1[m, 0] - a) * f1, (x1[m, 1] - b) * f1
            u, v = (x2[m, 0] - c) * f2, (x2[m, 1] - d) * f2
            row[0], row[1], row[2] = u * x, u * y, u
            row[3], row[4], row[5] = v * x, v * y, v
            row[6], row[7], row[8] = x, y, 1.0
            for i in range(9):
                scaled = w[m] * row[i]
                for j in range(i + 1):
                    A[i, j] += scaled * row[j]
    start = np.array([0.31, -0.22, 0.17, 0.41, 0.13, -0.37, 0.29, 0.47, 0.43])
    f = _smallest_vector(A, start).reshape(3, 3)
    _make_rank_two(f)
    # F = T2' f T1 with T = [[s, 0, -s cx], [0, s, -s cy], [0, 0, 1]].
    for i in range(3):
        f[i, 2] -= f1 * (f[i, 0] * a + f[i, 1] * b)
        f[i, 0] *= f1
        f[i, 1] *= f1
    for j in range(3):
        f[2, j] -= f2 * (f[0, j] * c + f[1, j] * d)
        f[0, j] *= f2
        f[1, j] *= f2
    norm = 0.0
    for i in range(3):
        for j in range(3):
            norm += f[i, j] ** 2
    if not 0.0 < norm < np.inf:
        return False
    F[:] = f / np.sqrt(norm)
    return True


@numba.njit(cache=True, nogil=True)
def _fit_weights(F, x1, x2, weights, limit_sq, out):  # type: ignore[no-untyped-def]
    """Write Tukey's weight of each match, over the squared gradient: the fit then minimises Sampson distances."""
    for m in range(len(x1)):
        x, y, u, v = x1[m, 0], x1[m, 1], x2[m, 0], x2[m, 1]
        l0 = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        l1 = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        l2 = F[2, 0] * x + F[2, 1] * y + F[2, 2]
        r0 = F[0, 0] * u + F[1, 0] * v + F[2, 0]
        r1 = F[0, 1] * u + F[1, 1] * v + F[2, 1]
        gradient = l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1
        e = u * l0 + v * l1 + l2
        rest = 1.0 - e * e / (gradient * limit_sq) if gradient > 0.0 else 0.0
        out[m] = weights[m] * rest * rest / gradient if rest > 0.0 else 0.0


@numba.njit(cache=True, nogil=True)
def refine_models(models, x1, x2, weights, thresholds):  # type: ignore[no-untyped-def]
    """Refit every model (K, 3, 3), in place, by weighted eight points over shrinking thresholds."""
    w = np.empty(len(x1))
    for k in range(len(models)):
        for threshold in thresholds:
            _fit_weights(models[k], x1, x2, weights, threshold * threshold, w)
            if not fit_weighted(x1, x2, w, models[k]):
                break


@numba.njit(cache=True, nogil=True)
def _squared_distances(F, x1, x2, out, gradient):  # type: ignore[no-untyped-def]
    for m in range(len(x1)):
        x, y, u, v = x1[m, 0], x1[m, 1], x2[m, 0], x2[m, 1]
        l0 = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        l1 = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        r0 = F[0, 0] * u + F[1, 0] * v + F[2, 0]
        r1 = F[0, 1] * u + F[1, 1] * v + F[2, 1]
        e = u * l0 + v * l1 + F[2, 0] * x + F[2, 1] * y + F[2, 2]
        gradient[m] = l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1
        out[m] = e * e / gradient[m] if gradient[m] > 0.0 else np.inf


@numba.njit(cache=True, nogil=True)
def _score(squares, weights, group, limit_sq):  # type: ignore[no-untyped-def]
    """Return what `score_models` returns for one model, from its squared distances."""
    total = best = 0.0
    for m in range(len(squares)):
        best = max(best, weights[m] * (1.0 - squares[m] / limit_sq))
        if m == len(squares) - 1 or group[m + 1] != group[m]:
            total += best
            best = 0.0
    return total


@numba.njit(cache=True, nogil=True)
def climb(model, x1, x2, prior, weights, group, limit, thresholds, reach, samples, state):  # type: ignore[no-untyped-def]
    """Improve `model` (3, 3) in place by local optimisation; return its score, that of `score_models` at `limit`.

    Inner samples of up to 14 of the matches within `reach` of the best so far, drawn by `prior`, are fitted and refined
    over `thresholds`; what scores higher becomes the best. The first attempt refines the model itself.
    """
    n = len(x1)
    squares, gradient, fit_weights, cumulative = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    trial = np.empty((1, 3, 3))
    _squared_distances(model, x1, x2, squares, gradient)
    best = _score(squares, weights, group, limit * limit)
    trial[0] = model
    for sample in range(samples + 1):
        if sample > 0:
            _squared_distances(model, x1, x2, squares, gradient)
            if not _inner_sample(squares, reach * reach, prior, gradient, fit_weights, cumulative, state):
                break
            if not fit_weighted(x1, x2, fit_weights, trial[0]):
                continue
        refine_models(trial, x1, x2, prior, thresholds)
        _squared_distances(trial[0], x1, x2, squares, gradient)
        score = _score(squares, weights, group, limit * limit)
        if score > best:
            best = score
            model[:] = trial[0]
    return best


@numba.njit(cache=True, nogil=True)
def _inner_sample(squares, reach_sq, prior, gradient, fit_weights, cumulative, state):  # type: ignore[no-untyped-def]
    """Give an inner sample its weights in the next fit; False where too few matches are near."""
    total, near = 0.0, 0
    for m in range(len(squares)):
        if squares[m] < reach_sq and prior[m] > 0.0:
            total += prior[m]
            near += 1
        cumulative[m] = total
    if near < 16:
        return False
    wanted = min(14, near // 2)
    fit_weights[:] = 0.0
    taken = 0
    for _ in range(10 * wanted):
        m = draw(cumulative, state)
        if fit_weights[m] == 0.0:
            fit_weights[m] = 1.0 / gradient[m]
            taken += 1
            if taken == wanted:
                break
    return taken >= 8
