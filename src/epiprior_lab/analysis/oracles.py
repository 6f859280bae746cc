"""What limits the results: runs that know the truth (beyond the paper).

A pair can be lost for three reasons: its putative matches hold too few right ones; no hypothesis among the rough
fundamental matrices is good; or a good one is there and another is chosen. Each oracle takes away one of them.
"""

from dataclasses import dataclass, replace

import numpy as np

from epiprior.geometry import (
    SCORE_THRESHOLD_PX,
    SHRINKING_THRESHOLDS_PX,
    eight_point,
    refine_fundamental,
    weighted_score,
)
from epiprior.types import BoolArray, FloatArray, MatchSet

_SURE = 0.99


@dataclass(frozen=True, kw_only=True)
class Labelled:
    """A ranked set of one roll hypothesis, and which of its matches are right.

    `pixel` is given pixels per working pixel; thresholds are meant in working pixels.
    """

    matches: MatchSet
    right: BoolArray
    pixel: float = 1.0

    def right_of(self, matches: MatchSet) -> BoolArray:
        """Return which of some of these matches, in any order, are right."""
        width = 1 + int(self.matches.feature2.max(initial=0))
        known = self.matches.feature1 * width + self.matches.feature2
        order = np.argsort(known)
        place = np.searchsorted(known, matches.feature1 * width + matches.feature2, sorter=order)
        return self.right[order[place]]

    @property
    def right_one_to_one(self) -> MatchSet:
        """Right matches, each feature once, best first."""
        return self.matches.take(self.right).one_to_one()


def labels_first(labelled: Labelled) -> MatchSet:
    """Return the set with labels for probabilities: right matches first, otherwise in their order."""
    order = np.argsort(~labelled.right, kind="stable")
    probability = np.where(labelled.right, _SURE, 1 - _SURE)
    return replace(labelled.matches, probability=probability).take(order)


def fit_right(labelled: Labelled) -> FloatArray | None:
    """Return F fitted to the right one-to-one matches, the best that their number and noise allow.

    None for fewer than eight, or where they do not determine F.
    """
    chosen = labelled.right_one_to_one
    F = eight_point(chosen.x1, chosen.x2)
    return None if F is None else _refined(F, chosen, np.ones(len(chosen)), labelled.pixel)


def refine_on_all(F: FloatArray, matches: MatchSet, pixel: float = 1.0) -> FloatArray:
    """Return F refined as the method does it: on all one-to-one matches, weighted by their probabilities."""
    wide = matches.one_to_one()
    return _refined(F, wide, wide.probability, pixel)


def _refined(F: FloatArray, matches: MatchSet, weights: FloatArray, pixel: float) -> FloatArray:
    thresholds, limit = [pixel * t for t in SHRINKING_THRESHOLDS_PX], pixel * SCORE_THRESHOLD_PX
    return refine_fundamental(F, matches.x1, matches.x2, weights, thresholds, score_threshold_px=limit)


def score(F: FloatArray, matches: MatchSet, pixel: float = 1.0) -> float:
    """Return the support of F among all one-to-one matches, weighted by their probabilities."""
    wide = matches.one_to_one()
    return weighted_score(F, wide.x1, wide.x2, wide.probability, pixel * SCORE_THRESHOLD_PX)
