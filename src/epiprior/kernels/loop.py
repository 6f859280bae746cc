"""The compiled loop of our own estimators: propose, score, optimise, stop. Sampler, score and local step are parts.

It draws by a generator of its own, on one thread: the same seed gives the same bytes.

For developers: numba's cache of a kernel does not notice changes in kernels that it calls. After a change in one of
them, delete ``__pycache__`` of this folder.
"""

import math

import numpy as np

from epiprior.kernels.algebra import copy_matrix
from epiprior.kernels.compilation import compiled
from epiprior.kernels.local_steps import joint_feature_weights, optimise
from epiprior.kernels.samples import fill_sample, next_uniform, on_one_plane, same_side
from epiprior.kernels.sampson import squared_distances
from epiprior.kernels.scores import BLOCK, score
from epiprior.kernels.solvers import seven_point, two_oriented

NO_LOCAL, FROM_SUPPORT, FROM_JOINT_DENSITY = 0, 1, 2
_GLOBAL, _LOCAL, _MIXED_SEVEN, _ORIENTED, _MIXED_ORIENTED = 0, 1, 2, 3, 4
_ORIENTED_RADIUS = 6.0
_PLANE_LIMIT = 2.0


@compiled
def propose(mode, columns, frames, cumulatives, separations, sample, models, state):  # type: ignore[no-untyped-def]
    """Draw a sample and write its hypotheses to `models`, shape (3, 3, 3); return how many.

    `cumulatives`, shape (4, N): of the prior, of the local weights, of the supporters, of the non-supporters.
    """
    oriented, mixed = mode in (_ORIENTED, _MIXED_ORIENTED), mode in (_MIXED_SEVEN, _MIXED_ORIENTED)
    head, tail = (2, 3) if mixed else (mode, mode) if not oriented else (0, 0)
    # Variables, not literals: numba compiles a kernel anew for every literal that it is called with.
    split, size = (1, 2) if oriented else (5 if mixed else 7, 7)
    separation_sq = separations[1 if oriented else 0]
    if not fill_sample(cumulatives[head], cumulatives[tail], split, size, state, columns, separation_sq, sample):
        return 0
    if oriented:
        return 1 if two_oriented(columns, frames, sample[0], sample[1], _ORIENTED_RADIUS, models[0]) else 0
    count = seven_point(columns, sample, models)
    kept = 0
    for k in range(count):
        if same_side(models[k], columns, sample):
            copy_matrix(models[k], models[kept])
            kept += 1
    return kept


@compiled
def _look_around(F, columns, prior, local, limit, cumulatives):  # type: ignore[no-untyped-def]
    """Enter where to look near `F` into `cumulatives`; return the share of the prior that supports `F`."""
    n = columns.shape[1]
    residual_sq, density = np.empty(n), np.empty(n)
    squared_distances(F, columns, residual_sq, density)
    by_density = local == FROM_JOINT_DENSITY and joint_feature_weights(F, columns, prior, limit, density)
    supporters, others, near = 0.0, 0.0, 0.0
    for i in range(n):
        if residual_sq[i] < limit * limit:
            supporters += prior[i]
            near += 0.0 if by_density else prior[i]
        else:
            others += prior[i]
        if by_density:
            near += density[i]
        cumulatives[1, i], cumulatives[2, i], cumulatives[3, i] = near, supporters, others
    return supporters / max(supporters + others, 1e-300)


@compiled
def run_loop(  # type: ignore[no-untyped-def]
    columns, frames, prior, cumulative, gain, odds, rest,
    kind, sigma, cut, raw_factor,
    oriented, local, local_share, local_growth, mixed_share, skip_planes,
    separations, good_share, log_miss, min_iterations, max_iterations, repeats, state,
):  # fmt: skip
    """Run the loop; return the best F, its score (0 or less: none) and the number of samples drawn."""
    n = columns.shape[1]
    cumulatives = np.zeros((4, n))
    for i in range(n):
        cumulatives[0, i] = cumulative[i]
    sample = np.zeros(7, np.int64)
    models = np.zeros((3, 3, 3))
    work = np.empty((2, BLOCK))
    records = np.zeros(5)  # one per mode: what a sample reaches before optimisation differs between them
    best, fallback, trial = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    best_score, fallback_score, mass = 0.0, 0.0, 0.0
    iterations, explored, needed = 0, 0, float(max_iterations)
    while iterations < max_iterations and (iterations < min_iterations or explored < needed):
        iterations += 1
        mode = _ORIENTED if oriented > 0.0 and next_uniform(state) < oriented else _GLOBAL
        if best_score > 0.0 and local != NO_LOCAL and next_uniform(state) < local_share + local_growth * mass:
            mode = _LOCAL
            if next_uniform(state) < mixed_share:
                mode = _MIXED_ORIENTED if next_uniform(state) < oriented else _MIXED_SEVEN
        explored += mode in (_GLOBAL, _ORIENTED)
        count = propose(mode, columns, frames, cumulatives, separations, sample, models, state)
        found = -1
        for k in range(count):
            value = score(
                models[k], columns, odds, rest, kind, sigma * raw_factor, cut * raw_factor, records[mode], work
            )
            if value <= records[mode]:
                continue
            if skip_planes and on_one_plane(models[k], columns, sample, (_PLANE_LIMIT * cut) ** 2) >= 6:
                if value > fallback_score:
                    fallback_score = value
                    copy_matrix(models[k], fallback)
                continue
            records[mode] = value
            found = k
        if found < 0:
            continue
        copy_matrix(models[found], trial)
        wide = (8.0 if mode in (_ORIENTED, _MIXED_ORIENTED) else 4.0) * cut
        value = optimise(trial, columns, gain, odds, rest, kind, sigma, cut, wide, repeats, state)
        if value > best_score:
            best_score = value
            copy_matrix(trial, best)
            mass = _look_around(best, columns, prior, local, cut, cumulatives)
            chance = good_share * (oriented * mass**2 + (1.0 - oriented) * mass**7)
            needed = log_miss / math.log1p(-chance) if 0.0 < chance < 1.0 else (0.0 if chance >= 1.0 else np.inf)
    if best_score <= 0.0 and fallback_score > 0.0:
        copy_matrix(fallback, best)
        best_score = optimise(best, columns, gain, odds, rest, kind, sigma, cut, 4.0 * cut, repeats, state)
    return best, best_score, iterations
