"""Compiled local steps: local optimisation around a hypothesis, and where to look near the best one.

Conventions as in `epiprior.kernels.solvers` and `epiprior.kernels.scores`.

References, as we recall them: LO-RANSAC: Chum, Matas and Kittler, DAGM 2003 (inner samples of up to 14 matches,
shrinking threshold); joint feature distributions: Triggs, ICCV 2001.
"""

from __future__ import annotations

import numba
import numpy as np

from epiprior.kernels.samplers import draw
from epiprior.kernels.scores import BLOCK, score, squared_residuals
from epiprior.kernels.small_algebra import copy_matrix
from epiprior.kernels.solvers import fill_row, weighted_eight_point

_INNER_SAMPLE = 14


@numba.njit(cache=True, nogil=True)
def fit_weights(F, columns, gain, limit, weights):  # type: ignore[no-untyped-def]
    """Write the weights of the next fit: gain, lowered towards the limit (Tukey), over the squared gradient.

    Divided by the squared gradient, the algebraic residual that the fit minimises is the Sampson distance.
    """
    gradient_sq = np.empty(len(weights))
    residual_sq = weights
    squared_gradients(F, columns, gradient_sq)
    squared_residuals(F, columns, residual_sq)
    limit_sq = limit * limit
    for i in range(len(weights)):
        if residual_sq[i] < limit_sq:
            t = 1.0 - residual_sq[i] / limit_sq
            weights[i] = gain[i] * t * t / max(gradient_sq[i], 1e-9)
        else:
            weights[i] = 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def squared_gradients(F, columns, out):  # type: ignore[no-untyped-def]
    """Write the squared gradients of ``x2' F x1`` of all matches to `out`."""
    for i in range(len(out)):
        x, y, u, v = columns[0, i], columns[1, i], columns[2, i], columns[3, i]
        l0 = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        l1 = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        r0 = F[0, 0] * u + F[1, 0] * v + F[2, 0]
        r1 = F[0, 1] * u + F[1, 1] * v + F[2, 1]
        out[i] = l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1


@numba.njit(cache=True, nogil=True)
def optimise(F, columns, gain, odds, rest, kind, sigma, cut, wide, steps, repeats, state):  # type: ignore[no-untyped-def]
    """Improve `F` in place by local optimisation; return its score.

    First straight from `F`, then from the best so far by `repeats` inner samples of min(14, I / 2) of its I supporters
    within twice the cut, drawn by their gain. Each is followed by fits to the matches within a limit that shrinks from
    `wide` to `cut` in `steps`. The best scored F is kept, the first included.

    `gain` weighs the fits, `odds` the score; `sigma` and `cut` belong to the score.
    """
    n = columns.shape[1]
    work = np.empty((2, BLOCK))
    weights, residual_sq = np.empty(n), np.empty(n)
    trial = F.copy()
    best = score(F, columns, odds, rest, kind, sigma, cut, -np.inf, work)
    for repeat in range(repeats + 1):
        if repeat > 0:
            squared_residuals(F, columns, residual_sq)
            if not _inner_sample(residual_sq, (2.0 * cut) ** 2, gain, weights, state):
                break
            if not weighted_eight_point(columns, weights, trial):
                continue
        for step in range(steps):
            limit = wide + (cut - wide) * step / (steps - 1)
            fit_weights(trial, columns, gain, limit, weights)
            if not weighted_eight_point(columns, weights, trial):
                break
            value = score(trial, columns, odds, rest, kind, sigma, cut, best, work)
            if value > best:
                best = value
                copy_matrix(trial, F)
        copy_matrix(F, trial)
    return best


@numba.njit(cache=True, nogil=True)
def _inner_sample(residual_sq, limit_sq, gain, weights, state):  # type: ignore[no-untyped-def]
    """Give weight 1 to an inner sample of the supporters; False where there are too few."""
    n = len(residual_sq)
    cumulative = np.empty(n)
    total, supporters = 0.0, 0
    for i in range(n):
        if residual_sq[i] < limit_sq and gain[i] > 0.0:
            total += gain[i]
            supporters += 1
        cumulative[i] = total
    if supporters < 16:
        return False
    weights[:] = 0.0
    wanted = min(_INNER_SAMPLE, supporters // 2)
    taken = 0
    for _ in range(10 * wanted):
        i = draw(cumulative, state)
        if weights[i] == 0.0:
            weights[i] = 1.0
            taken += 1
            if taken == wanted:
                break
    return taken >= 8


@numba.njit(cache=True, nogil=True)
def joint_feature_weights(F, columns, gain, limit, out):  # type: ignore[no-untyped-def]
    """Write the joint feature density of every match, given the supporters of `F`; return False below 8 supporters.

    With t the products of both homogeneous points, W the inverse of the supporters' regularised scatter of t, the
    density is ``exp(-t' W t / 2)`` up to a factor: high for matches that agree with F *and* lie where the supporters
    lie. A supporter has ``t' W t = 9`` in the mean; lower values count as 9: not only the heart is drawn from.
    """
    n = columns.shape[1]
    squared_residuals(F, columns, out)
    S = np.zeros((9, 9))
    row = np.empty(9)
    total, supporters = 0.0, 0
    for i in range(n):
        if out[i] < limit * limit and gain[i] > 0.0:
            fill_row(row, columns[0, i], columns[1, i], columns[2, i], columns[3, i])
            supporters += 1
            total += gain[i]
            for a in range(9):
                for b in range(9):
                    S[a, b] += gain[i] * row[a] * row[b]
    if supporters < 8:
        return False
    for a in range(9):
        for b in range(9):
            S[a, b] /= total
        S[a, a] += limit * limit  # the noise of the points keeps the scatter regular
    W = np.linalg.inv(S)
    for i in range(n):
        fill_row(row, columns[0, i], columns[1, i], columns[2, i], columns[3, i])
        q = 0.0
        for a in range(9):
            inner = 0.0
            for b in range(9):
                inner += W[a, b] * row[b]
            q += row[a] * inner
        out[i] = np.exp(-0.5 * max(q - 9.0, 0.0))
    return True
