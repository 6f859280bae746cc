"""BEEM-style estimation: exploration and exploitation in balance, two oriented matches per hypothesis.

Our interpretation of Goshen and Shimshoni (ECCV 2006; TPAMI 2008): the original program is not available, and only its
abstract was at hand. From the abstract: prior information; global exploration, local exploration near the best model
and its exploitation in balance; the best model guides the search, is left where it is degenerate, and tells when to
stop; F from two SIFT matches. How these are done is ours, see `Recipe`.
"""

from __future__ import annotations

from epiprior.estimators.loop import FROM_SUPPORT, Recipe
from epiprior.estimators.own import LoopEstimator
from epiprior.estimators.ratio_prior import probability_or_ratio_prior
from epiprior.kernels.scores import SUPPORT

# Exploration: two oriented matches by their prior (a quarter of the samples: seven matches). Exploitation: local
# optimisation of every hypothesis that beats all those before it. Local exploration: seven supporters, or supporters
# joined with non-supporters, which leads off a plane; the larger the share of the prior that supports the best model,
# the more of it. Stops when the chance of a better sample, by the prior's mass on the best support, is small.
ESTIMATORS = (
    LoopEstimator(
        name="beem",
        recipe=Recipe(
            kind=SUPPORT,
            weighted=True,
            oriented=0.75,
            local=FROM_SUPPORT,
            local_share=0.2,
            local_growth=0.4,
            mixed_share=0.5,
            raw_factor=3.0,
            good_sample_share=0.1,
        ),
        prior=probability_or_ratio_prior,
        max_iterations=5_000,
    ),
)
