"""Guided MLESAC: samples by the matches' probabilities and scores by the likelihood under them.

After Tordoff and Murray, Guided-MLESAC, TPAMI 2005, as we recall it: seven matches drawn by their probability v, score
sum log(v p_in(r) + (1 - v) / w). Local optimisation and the oriented constraint are ours.
"""

from __future__ import annotations

from epiprior.estimators.loop import Recipe
from epiprior.estimators.own import LoopEstimator
from epiprior.estimators.ratio_prior import probability_or_ratio_prior
from epiprior.kernels.scores import LIKELIHOOD

# It needs calibrated probabilities: without preprocessing they come from the distance ratio.
ESTIMATORS = (
    LoopEstimator(
        name="guided-mlesac",
        recipe=Recipe(kind=LIKELIHOOD),
        prior=probability_or_ratio_prior,
        max_iterations=5_000,
    ),
)
