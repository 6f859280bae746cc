"""The compiled loop of our own estimators: propose, score, optimise, stop. Sampler, score and local step are parts.

An estimator is a `Recipe`: what it samples from, how it scores, where it looks near the best model, when it stops.
`search` conditions the matches, runs the loop and returns F in pixels.

The loop draws from numba code with a generator of its own, on one thread: the same seed gives the same bytes.

For developers: numba's cache of a kernel does not notice changes in kernels that it calls. After a change in one of the
modules that this one imports kernels from, delete ``__pycache__`` of this folder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from epiprior.estimators.protocol import RawModel
from epiprior.kernels.conditioned import condition
from epiprior.kernels.local_steps import joint_feature_weights, optimise
from epiprior.kernels.sample_checks import on_one_plane, same_side
from epiprior.kernels.samplers import cumulated, fill_sample, generator_state, next_uniform
from epiprior.kernels.scores import (
    BLOCK,
    LIKELIHOOD,
    SUPPORT,
    attainable,
    cut_distance,
    likelihood_odds,
    score,
    squared_residuals,
)
from epiprior.kernels.small_algebra import copy_matrix
from epiprior.kernels.solvers import seven_point, two_oriented
from epiprior.types import FloatArray, MatchSet

NO_LOCAL, FROM_SUPPORT, FROM_JOINT_DENSITY = 0, 1, 2
_GLOBAL, _LOCAL, _MIXED_SEVEN, _ORIENTED, _MIXED_ORIENTED = 0, 1, 2, 3, 4
_ORIENTED_RADIUS = 6.0
_ORIENTED_SEPARATION_PX = 20.0
_SEPARATION_PX = 2.0
_PLANE_LIMIT = 2.0
_SIGMAS_OF_THRESHOLD = 2.0


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What distinguishes one estimator of the loop from another.

    Parameters
    ----------
    kind : int
        `SUPPORT`, `LIKELIHOOD` or `KERNEL` of `epiprior.kernels.scores`.
    weighted : bool
        Whether a match counts by its probability in the score and in local optimisation, where matches carry
        probabilities; without, all count alike: a prior from descriptors alone is too weak to count by, measured
        on validation scenes. The likelihood always knows the prior.
    oriented : float
        Share of two oriented matches among the global samples, in [0, 1]; the others are seven matches.
    local : int
        `NO_LOCAL`, `FROM_SUPPORT` or `FROM_JOINT_DENSITY`: whence local samples of seven are drawn.
    local_share, local_growth : float
        Share of local proposals once there is a model, ``local_share + local_growth * mass`` where mass is
        the share of the prior that supports the best model: an estimate of its quality.
    mixed_share : float
        Of the local proposals, the share that joins supporters and non-supporters.
    skip_planes : bool
        Whether a sample of seven, six of which agree with one homography, is ruled out.
    raw_factor : float
        Hypotheses are compared at so many times the threshold before they are optimised, >= 1: rough ones
        would look all alike at the threshold itself.
    good_sample_share : float
        Of the samples of right matches, how many give an F that local optimisation can mend; enters the
        stopping rule.
    min_iterations : int
        Hypotheses drawn before the loop may stop.
    repeats : int
        Inner samples of local optimisation.
    """

    kind: int
    weighted: bool = False
    oriented: float = 0.0
    local: int = NO_LOCAL
    local_share: float = 0.0
    local_growth: float = 0.0
    mixed_share: float = 0.0
    skip_planes: bool = False
    raw_factor: float = 1.0
    good_sample_share: float = 0.5
    min_iterations: int = 200
    repeats: int = 5


@numba.njit(cache=True, nogil=True)
def propose(mode, columns, frames, cumulatives, separations, sample, models, state):  # type: ignore[no-untyped-def]
    """Draw a sample and write its hypotheses to `models`, shape (3, 3, 3); return how many.

    `cumulatives`, shape (4, N): of the prior, of the local weights, of the supporters, of the non-supporters.
    """
    if mode in (_ORIENTED, _MIXED_ORIENTED):
        first, second = (0, 0) if mode == _ORIENTED else (2, 3)
        drawn = fill_sample(cumulatives[first], state, columns, separations[1], sample, 0, 1)
        drawn = drawn and fill_sample(cumulatives[second], state, columns, separations[1], sample, 1, 2)
        made = drawn and two_oriented(columns, frames, sample[0], sample[1], _ORIENTED_RADIUS, models[0])
        return 1 if made else 0
    if mode == _MIXED_SEVEN:
        drawn = fill_sample(cumulatives[2], state, columns, separations[0], sample, 0, 5)
        drawn = drawn and fill_sample(cumulatives[3], state, columns, separations[0], sample, 5, 7)
    else:
        drawn = fill_sample(cumulatives[mode], state, columns, separations[0], sample, 0, 7)
    if not drawn:
        return 0
    count = seven_point(columns, sample, models)
    kept = 0
    for k in range(count):
        if same_side(models[k], columns, sample):
            copy_matrix(models[k], models[kept])
            kept += 1
    return kept


@numba.njit(cache=True, nogil=True)
def _look_around(F, columns, prior, local, limit, cumulatives):  # type: ignore[no-untyped-def]
    """Enter where to look near `F` into `cumulatives`; return the share of the prior that supports `F`."""
    n = columns.shape[1]
    residual_sq, density = np.empty(n), np.empty(n)
    squared_residuals(F, columns, residual_sq)
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


@numba.njit(cache=True, nogil=True)
def run_loop(  # type: ignore[no-untyped-def]
    columns, frames, prior, cumulative, gain, odds, rest, raw_rest,
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
                models[k], columns, odds, raw_rest, kind, sigma * raw_factor, cut * raw_factor, records[mode], work
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
        value = optimise(trial, columns, gain, odds, rest, kind, sigma, cut, wide, 4, repeats, state)
        if value > best_score:
            best_score = value
            copy_matrix(trial, best)
            mass = _look_around(best, columns, prior, local, cut, cumulatives)
            chance = good_share * (oriented * mass**2 + (1.0 - oriented) * mass**7)
            needed = log_miss / math.log1p(-chance) if 0.0 < chance < 1.0 else (0.0 if chance >= 1.0 else np.inf)
    if best_score <= 0.0 and fallback_score > 0.0:
        copy_matrix(fallback, best)
        best_score = optimise(best, columns, gain, odds, rest, kind, sigma, cut, 4.0 * cut, 4, repeats, state)
    return best, best_score, iterations


def search(
    matches: MatchSet,
    prior: FloatArray,
    recipe: Recipe,
    *,
    threshold_px: float,
    confidence: float,
    max_iterations: int,
    seed: int,
) -> RawModel:
    """Run the loop on distinct, finite matches.

    Parameters
    ----------
    matches : MatchSet
        Best first: the order does not enter the result's distribution, but the score bails out earlier.
    prior : ndarray, shape (N,), float64
        Weight of each match in sampling, >= 0; in [0, 1] where the recipe weighs scores by it.
    recipe : Recipe
        The estimator.
    threshold_px : float
        Inlier threshold; the standard deviation of an inlier's distance is taken to be half of it.
    confidence : float
        Wanted probability of having drawn a good sample.
    max_iterations : int
        Cap on the samples drawn.
    seed : int
        >= 0.

    Returns
    -------
    RawModel
        F in pixels, None if no hypothesis had any support.
    """
    conditioned = condition(matches)
    sigma = threshold_px / conditioned.unit_px
    if recipe.kind != SUPPORT:
        sigma /= _SIGMAS_OF_THRESHOLD
    prior = np.ascontiguousarray(prior, dtype=np.float64)
    weighted = recipe.weighted and not np.isnan(matches.probability).any()
    gain = prior if weighted or recipe.kind == LIKELIHOOD else np.ones(len(prior))
    odds = gain
    if recipe.kind == LIKELIHOOD:
        extent = float(np.ptp(conditioned.columns[2]) + np.ptp(conditioned.columns[3])) / 2.0
        odds = likelihood_odds(prior, sigma, max(extent, sigma))
    separations = np.array([_SEPARATION_PX, _ORIENTED_SEPARATION_PX]) / conditioned.unit_px
    rest = attainable(odds, recipe.kind)
    F, value, iterations = run_loop(
        conditioned.columns, conditioned.frames, prior, cumulated(prior), gain, odds, rest, rest,
        recipe.kind, sigma, cut_distance(recipe.kind, sigma), recipe.raw_factor,
        recipe.oriented, recipe.local, recipe.local_share, recipe.local_growth, recipe.mixed_share, recipe.skip_planes,
        separations**2, recipe.good_sample_share, math.log1p(-confidence),
        recipe.min_iterations, max_iterations, recipe.repeats, generator_state(seed),
    )  # fmt: skip
    return RawModel(F=conditioned.to_pixels(F) if value > 0 else None, iterations=int(iterations))
