"""Generalised RANSAC: guided sampling over many candidates per feature, each at a low probability.

After Zhang and Kosecka (Generalized RANSAC framework for relaxed correspondence problems, 3DPVT 2006), as the paper
sums it up (section 2): all matches above a threshold of normalised cross-correlation, low probabilities, guided
RANSAC. Its input is `epiprior.generalized_matches`. Local optimisation and the oriented constraint are ours.
"""

from __future__ import annotations

from epiprior.estimators.loop import Recipe
from epiprior.estimators.own import LoopEstimator
from epiprior.estimators.ratio_prior import probability_or_ratio_prior
from epiprior.kernels.scores import SUPPORT

# Seven matches by their probability, no two at one point; support is the truncated quadratic (MSAC), in which a match
# counts by its probability: the candidates of a feature share one vote.
ESTIMATORS = (
    LoopEstimator(
        name="generalized-ransac",
        recipe=Recipe(kind=SUPPORT, weighted=True),
        prior=probability_or_ratio_prior,
        max_iterations=5_000,
    ),
)
