"""What the matches say for a fundamental matrix: the score of the estimator ``epiprior``.

A sum of the probabilities alone would not do: matches are not independent. A window that was taken for its neighbour
gives ten matches that agree with one another, and with every F that agrees with one of them. So matches that lead from
one small part of image 1 to one small part of image 2 count once, by the best of them; and F itself must be one that
two photographs can have (`epiprior.verification.measures`), which does not depend on the matches at all.
"""

from epiprior.geometry import SCORE_THRESHOLD_PX, Evidence
from epiprior.types import FloatArray, MatchSet
from epiprior.verification.measures import camera_plausibility, match_weights, prior_probability, spread_groups


def spread_evidence(F: FloatArray, matches: MatchSet, threshold_px: float = SCORE_THRESHOLD_PX) -> float:
    """Return the score of one F, >= 0: the matches, each part of the images once, times the plausibility of F.

    Many-to-many matches are made one-to-one: each feature speaks once, by its most probable match. A match at a Sampson
    distance of `threshold_px` says nothing. The score may be compared between roll hypotheses of one pair.
    """
    single = matches.one_to_one()
    weights = match_weights(single, prior_probability(single))
    evidence = Evidence(single.x1, single.x2, weights, spread_groups(single.x1, single.x2))
    return float(evidence.scores(F[None], threshold_px)[0] * camera_plausibility(F[None], single.image_sizes)[0])
