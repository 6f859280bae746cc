"""What the matches say for a fundamental matrix: the score of the estimator ``epiprior``.

A sum of the probabilities alone would not do: matches are not independent. A window that was taken for its neighbour
gives ten matches that agree with one another, and with every F that agrees with one of them. So matches that lead from
one small part of image 1 to one small part of image 2 count once, by the best of them; and F itself must be one that
two photographs can have (`epiprior.verification.measures`), which does not depend on the matches at all.
"""

import numpy as np

from epiprior.geometry import SCORE_THRESHOLD_PX, as_columns, centred_columns
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.scores import BLOCK, score_models
from epiprior.types import FloatArray, IntArray, MatchSet
from epiprior.verification.measures import camera_plausibility, match_weights, prior_probability, spread_groups


class Evidence:
    """N matches with their weights, arranged for scoring many F; of the matches of one group only the best counts."""

    def __init__(self, x1: FloatArray, x2: FloatArray, weights: FloatArray, group: IntArray) -> None:
        order = np.argsort(group, kind="stable")
        # Pixels from the means of the points: single precision is then exact enough.
        self.centre1, self.centre2 = (x.mean(axis=0) if len(x) else np.zeros(2) for x in (x1, x2))
        self.columns = as_columns((x1 - self.centre1)[order], (x2 - self.centre2)[order]).astype(np.float32)
        self.weights = weights[order].astype(np.float32)
        self.group = np.asarray(group[order], dtype=np.int64)

    def scores(self, models: FloatArray, threshold_px: float) -> FloatArray:
        """Return the score of each of `models` (K, 3, 3): shape (K,), float64, >= 0.

        A group says what its best match says: w (1 - r^2 / threshold^2) at the Sampson distance r, nothing beyond.
        """
        found = np.zeros(len(models), np.float32)
        if len(models) and len(self.weights):
            centred = centred_columns(models, self.centre1, self.centre2)
            limit_sq = np.float32(threshold_px**2)

            def work(part: slice) -> None:
                some = np.ascontiguousarray(centred[:, part])
                score_models(some, self.columns, self.weights, self.group, limit_sq, found[part])

            in_chunks(work, len(models), 2 * BLOCK)
        return np.nan_to_num(found.astype(np.float64), nan=0.0)


def spread_evidence(F: FloatArray, matches: MatchSet, threshold_px: float = SCORE_THRESHOLD_PX) -> float:
    """Return the score of one F, >= 0: the matches, each part of the images once, times the plausibility of F.

    Many-to-many matches are made one-to-one: each feature speaks once, by its most probable match. A match at a Sampson
    distance of `threshold_px` says nothing. The score may be compared between roll hypotheses of one pair.
    """
    single = matches.one_to_one()
    weights = match_weights(single, prior_probability(single))
    evidence = Evidence(single.x1, single.x2, weights, spread_groups(single.x1, single.x2))
    return float(evidence.scores(F[None], threshold_px)[0] * camera_plausibility(F[None], single.image_sizes)[0])
