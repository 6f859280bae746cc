"""BLOGS-style estimation: balanced local and global search under a probabilistic support.

Our interpretation of Brahmachari and Sarkar (ICCV 2009; TPAMI 2013, Hop-Diffusion Monte Carlo), of which only the
abstracts were at hand: global proposals (hops) guided by the similarity of matches, local ones (diffusion) by the joint
feature distribution of the best model, support that is probabilistic, degenerate configurations ruled out.
"""

from __future__ import annotations

import numpy as np

from epiprior.estimators.loop import FROM_JOINT_DENSITY, Recipe
from epiprior.estimators.own import LoopEstimator
from epiprior.estimators.ratio_prior import inlier_probability
from epiprior.kernels.scores import KERNEL
from epiprior.types import FloatArray, MatchSet


def similarity_prior(matches: MatchSet) -> FloatArray:
    """Return the probabilities; without them the similarity weights t_k; without these, a prior from d_r.

    References
    ----------
    t_k: paper, section 4.1.
    """
    if not np.isnan(matches.probability).any():
        return matches.probability
    highest = float(matches.similarity_weight.max(initial=0.0))
    return matches.similarity_weight / highest if highest > 0 else inlier_probability(matches.distance_ratio)


# Hops and diffusion alternate at random, half and half. A fixed budget of samples, as we recall; the chain is greedy:
# it moves to what is better. Samples six of which agree with one homography, compatible with F, are ruled out.
_BUDGET = 2_000
ESTIMATORS = (
    LoopEstimator(
        name="blogs",
        recipe=Recipe(
            kind=KERNEL,
            weighted=True,
            local=FROM_JOINT_DENSITY,
            local_share=0.5,
            skip_planes=True,
            min_iterations=_BUDGET,
        ),
        prior=similarity_prior,
        max_iterations=_BUDGET,
    ),
)
