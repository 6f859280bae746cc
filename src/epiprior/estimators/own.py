"""Our own estimators of the compiled loop (`epiprior.kernels.loop`): each is a recipe, whose sources stand beside it.

Local optimisation and the oriented constraint are ours.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from epiprior.estimators.protocol import CONFIDENCE, Estimator
from epiprior.estimators.ratio_prior import inlier_probability, probability_or_ratio_prior
from epiprior.geometry import as_columns
from epiprior.kernels.loop import FROM_JOINT_DENSITY, FROM_SUPPORT, NO_LOCAL, run_loop
from epiprior.kernels.samples import cumulated, generator_state
from epiprior.kernels.scores import KERNEL, LIKELIHOOD, SUPPORT, attainable, cut_distance, likelihood_odds
from epiprior.types import FloatArray, MatchSet

_ORIENTED_SEPARATION_PX = 20.0
_SEPARATION_PX = 2.0
_SIGMAS_OF_THRESHOLD = 2.0


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What distinguishes one estimator of the loop from another.

    Where matches carry no probabilities, all count alike even if `weighted`: a prior from descriptors alone is too
    weak, measured on validation scenes. The likelihood always knows the prior.
    """

    prior: Callable[[MatchSet], FloatArray] = probability_or_ratio_prior  # weight in sampling, (N,) in [0, 1]
    kind: int  # `SUPPORT`, `LIKELIHOOD` or `KERNEL` of `epiprior.kernels.scores`
    weighted: bool = False  # whether a match counts by its probability in the score and in local optimisation
    oriented: float = 0.0  # share of two oriented matches among the global samples; the others are seven matches
    local: int = NO_LOCAL  # or `FROM_SUPPORT` or `FROM_JOINT_DENSITY`: whence local samples of seven are drawn
    local_share: float = 0.0  # share of local proposals once there is a model,
    local_growth: float = 0.0  # plus this times the share of the prior that supports the best model (its quality)
    mixed_share: float = 0.0  # of the local proposals, the share that joins supporters and non-supporters
    skip_planes: bool = False  # whether a sample of seven, six of which agree with one homography, is ruled out
    raw_factor: float = 1.0  # >= 1: rough hypotheses, before they are optimised, are compared at so many thresholds
    good_sample_share: float = 0.5  # of the samples of right matches, how many local optimisation can mend: to stop
    min_iterations: int = 200  # hypotheses drawn before the loop may stop
    repeats: int = 5  # inner samples of local optimisation


def search(
    recipe: Recipe, matches: MatchSet, threshold_px: float, cap: int, seed: int
) -> tuple[FloatArray | None, int]:
    """Run the loop: F, None if no hypothesis had any support, and the number of samples drawn.

    The order of the matches does not enter the result's distribution, but with the best first the score stops earlier.
    The standard deviation of an inlier's distance is taken to be half of `threshold_px`.
    """
    conditioned = condition(matches)
    sigma = threshold_px / conditioned.unit_px
    if recipe.kind != SUPPORT:
        sigma /= _SIGMAS_OF_THRESHOLD
    prior = np.ascontiguousarray(recipe.prior(matches), dtype=np.float64)
    weighted = recipe.weighted and not np.isnan(matches.probability).any()
    gain = prior if weighted or recipe.kind == LIKELIHOOD else np.ones(len(prior))
    odds = gain
    if recipe.kind == LIKELIHOOD:
        extent = float(np.ptp(conditioned.columns[2]) + np.ptp(conditioned.columns[3])) / 2.0
        odds = likelihood_odds(prior, sigma, max(extent, sigma))
    separations = np.array([_SEPARATION_PX, _ORIENTED_SEPARATION_PX]) / conditioned.unit_px
    F, value, iterations = run_loop(
        conditioned.columns, conditioned.frames, prior, cumulated(prior), gain, odds, attainable(odds, recipe.kind),
        recipe.kind, sigma, cut_distance(recipe.kind, sigma), recipe.raw_factor,
        recipe.oriented, recipe.local, recipe.local_share, recipe.local_growth, recipe.mixed_share, recipe.skip_planes,
        separations**2, recipe.good_sample_share, math.log1p(-CONFIDENCE),
        recipe.min_iterations, cap, recipe.repeats, generator_state(seed),
    )  # fmt: skip
    return conditioned.to_pixels(F) if value > 0 else None, int(iterations)


@dataclass(frozen=True, kw_only=True)
class Conditioned:
    """Matches as the compiled parts want them."""

    columns: FloatArray  # (4, N): x and y in image 1, x and y in image 2, centred and divided by `unit_px`
    frames: FloatArray  # (4, N): scale in image 1 and 2 in units, orientation in image 1 and 2 in radians
    centre1: FloatArray  # (2,), what was subtracted, pixels
    centre2: FloatArray
    unit_px: float  # pixels per unit, the same for both images

    def to_pixels(self, F: FloatArray) -> FloatArray:
        """Return F of conditioned coordinates as an F of pixels."""
        T1, T2 = (np.array([[1, 0, -c[0]], [0, 1, -c[1]], [0, 0, self.unit_px]]) for c in (self.centre1, self.centre2))
        return np.asarray(T2.T @ F @ T1)


def condition(matches: MatchSet) -> Conditioned:
    """Centre the matches in both images and divide by one length, the mean spread of both, for the solvers."""
    c1, c2 = matches.x1.mean(axis=0), matches.x2.mean(axis=0)
    spread = ((matches.x1 - c1) ** 2).sum(axis=1).mean() + ((matches.x2 - c2) ** 2).sum(axis=1).mean()
    unit = max(math.sqrt(float(spread) / 4.0), 1e-9)
    columns = as_columns(matches.x1 - c1, matches.x2 - c2) / unit
    scales, angles = (matches.scale1, matches.scale2), (matches.orientation1_deg, matches.orientation2_deg)
    frames = np.stack([*(scale / unit for scale in scales), *(np.deg2rad(angle) for angle in angles)])
    return Conditioned(columns=columns, frames=frames, centre1=c1, centre2=c2, unit_px=unit)


def similarity_prior(matches: MatchSet) -> FloatArray:
    """Return the probabilities; without them the similarity weights t_k (section 4.1); else a prior from d_r."""
    if not np.isnan(matches.probability).any():
        return matches.probability
    highest = float(matches.similarity_weight.max(initial=0.0))
    return matches.similarity_weight / highest if highest > 0 else inlier_probability(matches.distance_ratio)


_RECIPES = {
    # After Tordoff and Murray (TPAMI 2005, as we recall it): seven matches drawn by their probability v, score
    # sum log(v p_in(r) + (1 - v) / w). It needs calibrated probabilities.
    "guided-mlesac": Recipe(kind=LIKELIHOOD),
    # BEEM-style, our interpretation of Goshen and Shimshoni (ECCV 2006; TPAMI 2008), of which only the abstract was at
    # hand. Exploration: two oriented matches by their prior (a quarter of the samples: seven matches). Exploitation:
    # local optimisation of every hypothesis that beats all those before it. Local exploration: seven supporters, or
    # supporters joined with non-supporters, which leads off a plane; the larger the share of the prior that supports
    # the best model, the more of it. Stops when the chance of a better sample, by the prior's mass on the best support,
    # is small.
    "beem": Recipe(
        kind=SUPPORT, weighted=True, oriented=0.75, local=FROM_SUPPORT, local_share=0.2, local_growth=0.4,
        mixed_share=0.5, raw_factor=3.0, good_sample_share=0.1,
    ),
    # BLOGS-style, our interpretation of Brahmachari and Sarkar (ICCV 2009; TPAMI 2013, Hop-Diffusion Monte Carlo), of
    # which only the abstracts were at hand. Global proposals (hops), by the similarity of matches, and local ones
    # (diffusion), by the joint feature distribution of the best model, alternate at random, half and half. A fixed
    # budget of samples, as we recall; the chain moves to what is better only. Samples six of which agree with one
    # homography, compatible with F, are ruled out.
    "blogs": Recipe(
        kind=KERNEL, weighted=True, local=FROM_JOINT_DENSITY, local_share=0.5, skip_planes=True, min_iterations=2000,
        prior=similarity_prior,
    ),
    # After Zhang and Kosecka (3DPVT 2006), as the paper sums it up (section 2): many candidates per feature, those of
    # `epiprior.generalized_matches`. Seven matches by their probability, no two at one point; support is the truncated
    # quadratic (MSAC), in which a match counts by its probability: the candidates of a feature share one vote.
    "generalized-ransac": Recipe(kind=SUPPORT, weighted=True),
}  # fmt: skip
# The caps are of samples; each may give up to three hypotheses.
ESTIMATORS = tuple(
    Estimator(name=name, run=partial(search, recipe), max_iterations=2_000 if name == "blogs" else 5_000)
    for name, recipe in _RECIPES.items()
)
