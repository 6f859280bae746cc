"""What the matches say for a fundamental matrix: the score of the estimator ``epiprior``.

A sum of the probabilities alone would not do: matches are not independent. A window that was taken for its neighbour
gives ten matches that agree with one another, and with every F that agrees with one of them. So matches that lead from
one small part of image 1 to one small part of image 2 count once, by the best of them; and F itself must be one that
two photographs can have (`epiprior.verification.measures`), which does not depend on the matches at all.
"""

from functools import cached_property

from epiprior.geometry import SCORE_THRESHOLD_PX, Evidence
from epiprior.types import FloatArray, MatchSet
from epiprior.verification.measures import camera_plausibility, spread_groups, weighed_matches


class SpreadEvidence:
    """The evidence of matches, each part of the images once.

    Many-to-many matches are made one-to-one, `single`: each feature speaks once, by its most probable match; `weights`
    are what these are worth (`match_weights`).
    """

    def __init__(self, matches: MatchSet) -> None:
        self.single, self.weights = weighed_matches(matches)

    @cached_property
    def _evidence(self) -> Evidence:
        x1, x2 = self.single.x1, self.single.x2
        return Evidence(x1, x2, self.weights, spread_groups(x1, x2))

    def score(self, F: FloatArray, threshold_px: float = SCORE_THRESHOLD_PX) -> float:
        """Return the score of one F, >= 0: what the matches say, times the plausibility of F.

        A match at a Sampson distance of `threshold_px` says nothing. The score may be compared between roll hypotheses
        of one pair.
        """
        plausibility = camera_plausibility(F[None], self.single.image_sizes)[0]
        return float(self._evidence.scores(F[None], threshold_px)[0] * plausibility)
