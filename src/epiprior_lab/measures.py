"""Measures of rankings (boolean: whether each match is right, best first) and of probabilities."""

from dataclasses import dataclass

import numpy as np

from epiprior.errors import SettingsError
from epiprior.types import BoolArray, FloatArray, IntArray


def precision_at(right: BoolArray, depth: int) -> float:
    """Return the share of right ones among the first `depth`; as in the paper, what a shorter list lacks is wrong."""
    return float(np.count_nonzero(right[:depth]) / depth)


def average_precision(right: BoolArray) -> float:
    """Return the mean over the right matches of the precision at their rank; 0 if none is right."""
    hits = np.flatnonzero(right)
    if not len(hits):
        return 0.0
    return float((np.arange(1, len(hits) + 1) / (hits + 1)).mean())


@dataclass(frozen=True, kw_only=True)
class CalibrationBins:
    """Sums over equal bins of probability, shape (B,), which add up over pairs; errors are from 1 (right) or 0."""

    count: IntArray
    right: IntArray
    probability: FloatArray
    squared_error: FloatArray

    @property
    def curve(self) -> FloatArray:
        """Reliability curve, shape (K, 3): mean probability, share of right matches, and count of the filled bins."""
        kept = self.count > 0
        count = self.count[kept]
        return np.column_stack([self.probability[kept] / count, self.right[kept] / count, count])

    @property
    def brier_score(self) -> float:
        """Mean squared error of the probabilities; NaN without matches."""
        return float(self.squared_error.sum() / self.count.sum()) if self.count.sum() else float("nan")

    @property
    def expected_calibration_error(self) -> float:
        """Mean gap over bins between probability and share of right matches, weighted by matches."""
        gaps = np.abs(self.probability - self.right).sum()
        return float(gaps / self.count.sum()) if self.count.sum() else float("nan")


def calibration_bins(probability: FloatArray, right: BoolArray, bins: int = 20) -> CalibrationBins:
    """Sum probabilities and outcomes over equal bins of [0, 1]; SettingsError if a probability is not in it."""
    p = np.asarray(probability, np.float64)
    if len(p) and not (p.min() >= 0 and p.max() <= 1):
        raise SettingsError(f"calibration: probabilities from {p.min()} to {p.max()}, expected 0 to 1")
    index = np.minimum((p * bins).astype(np.int64), bins - 1)

    def sums(weights: FloatArray) -> FloatArray:
        return np.bincount(index, weights=weights, minlength=bins).astype(np.float64)

    return CalibrationBins(
        count=np.bincount(index, minlength=bins),
        right=np.bincount(index[right], minlength=bins),
        probability=sums(p),
        squared_error=sums((p - right) ** 2),
    )
