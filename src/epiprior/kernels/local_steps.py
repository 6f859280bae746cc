"""Compiled local steps: local optimisation around a hypothesis, and where to look near the best one.

Of the loop (`optimise`, `joint_feature_weights`) and of the estimator ``epiprior`` (`refine_models`, `climb`).
Conventions as in `epiprior.kernels.solvers` and `epiprior.kernels.scores`.

References, as we recall them: LO-RANSAC: Chum, Matas and Kittler, DAGM 2003 (inner samples of up to 14 matches,
shrinking threshold); joint feature distributions: Triggs, ICCV 2001.
"""

import numpy as np

from epiprior.kernels.algebra import copy_matrix
from epiprior.kernels.compilation import compiled
from epiprior.kernels.samples import draw
from epiprior.kernels.sampson import squared_distances, tukey_weights
from epiprior.kernels.scores import BLOCK, score, score_of_groups
from epiprior.kernels.solvers import fill_row, weighted_eight_point

_INNER_SAMPLE, _STEPS = 14, 4


@compiled
def inner_sample(residual_sq, limit_sq, gain, weights, state):  # type: ignore[no-untyped-def]
    """Give weight 1 to up to 14 of the supporters, drawn by their gain; False where there are too few."""
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
    for i in range(n):
        weights[i] = 0.0
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


@compiled
def optimise(F, columns, gain, odds, rest, kind, sigma, cut, wide, repeats, state):  # type: ignore[no-untyped-def]
    """Improve `F` in place by local optimisation; return its score.

    First straight from `F`, then from the best so far by `repeats` inner samples of min(14, I / 2) of its I supporters
    within twice the cut, drawn by their gain. Each is followed by fits to the matches within a limit that shrinks from
    `wide` to `cut` in four steps. The best scored F is kept, the first included.

    `gain` weighs the fits, `odds` the score; `sigma` and `cut` belong to the score.
    """
    n = columns.shape[1]
    work = np.empty((2, BLOCK))
    weights, residual_sq, gradient_sq = np.empty(n), np.empty(n), np.empty(n)
    trial = np.empty((3, 3))
    copy_matrix(F, trial)
    best = score(F, columns, odds, rest, kind, sigma, cut, -np.inf, work)
    for repeat in range(repeats + 1):
        if repeat > 0:
            squared_distances(F, columns, residual_sq, gradient_sq)
            if not inner_sample(residual_sq, (2.0 * cut) ** 2, gain, weights, state):
                break
            if not weighted_eight_point(columns, weights, trial):
                continue
        for step in range(_STEPS):
            limit = wide + (cut - wide) * step / (_STEPS - 1)
            tukey_weights(trial, columns, gain, limit * limit, weights, gradient_sq)
            if not weighted_eight_point(columns, weights, trial):
                break
            value = score(trial, columns, odds, rest, kind, sigma, cut, best, work)
            if value > best:
                best = value
                copy_matrix(trial, F)
        copy_matrix(F, trial)
    return best


@compiled
def joint_feature_weights(F, columns, gain, limit, out):  # type: ignore[no-untyped-def]
    """Write the joint feature density of every match, given the supporters of `F`; return False below 8 supporters.

    With t the products of both homogeneous points, W the inverse of the supporters' regularised scatter of t, the
    density is ``exp(-t' W t / 2)`` up to a factor: high for matches that agree with F *and* lie where the supporters
    lie. A supporter has ``t' W t = 9`` in the mean; lower values count as 9: not only the heart is drawn from.
    """
    n = columns.shape[1]
    squared_distances(F, columns, out, np.empty(n))
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


@compiled
def refine_models(models, columns, weights, thresholds):  # type: ignore[no-untyped-def]
    """Refit every model (K, 3, 3), in place, by weighted eight points over shrinking thresholds."""
    w, gradient_sq = np.empty(len(weights)), np.empty(len(weights))
    for k in range(len(models)):
        for threshold in thresholds:
            tukey_weights(models[k], columns, weights, threshold * threshold, w, gradient_sq)
            if not weighted_eight_point(columns, w, models[k]):
                break


@compiled
def climb(model, columns, prior, weights, group, limit, thresholds, reach, samples, state):  # type: ignore[no-untyped-def]
    """Improve `model` (3, 3) in place by local optimisation; return its score, that of `score_models` at `limit`.

    Inner samples of up to 14 of the matches within `reach` of the best so far, drawn by `prior`, are fitted and refined
    over `thresholds`; what scores higher becomes the best. The first attempt refines the model itself.
    """
    n = columns.shape[1]
    squares, gradient_sq, drawn = np.empty(n), np.empty(n), np.empty(n)
    trial = np.empty((1, 3, 3))
    squared_distances(model, columns, squares, gradient_sq)
    best = score_of_groups(squares, weights, group, limit * limit)
    copy_matrix(model, trial[0])
    for sample in range(samples + 1):
        if sample > 0:
            squared_distances(model, columns, squares, gradient_sq)
            if not inner_sample(squares, reach * reach, prior, drawn, state):
                break
            for m in range(n):
                drawn[m] /= gradient_sq[m] if drawn[m] > 0.0 else 1.0
            if not weighted_eight_point(columns, drawn, trial[0]):
                continue
        refine_models(trial, columns, prior, thresholds)
        squared_distances(trial[0], columns, squares, gradient_sq)
        score = score_of_groups(squares, weights, group, limit * limit)
        if score > best:
            best = score
            copy_matrix(trial[0], model)
    return best
