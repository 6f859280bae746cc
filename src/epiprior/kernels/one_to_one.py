"""One-to-one matches of a ranking: a feature may be used once. Beyond the paper, whose rankings are many-to-many."""

import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError
from epiprior.kernels.compilation import compiled

_SPARSE = 100


@compiled
def _walk(feature1, feature2, used1, used2):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(feature1), np.bool_)
    for m in range(len(feature1)):
        i, j = feature1[m], feature2[m]
        if not used1[i] and not used2[j]:
            used1[i] = used2[j] = True
            keep[m] = True
    return keep


def one_to_one_mask(feature1: NDArray[np.int64], feature2: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which matches (N,) remain if a match is skipped whose feature, in either image, was used before.

    `feature1` and `feature2`, shape (N,), best match first, are any numbers >= 0. The result is a greedy matching: no
    match could be added to it. Raises FeatureError if shapes disagree or a number is negative.
    """
    first, second = np.asarray(feature1, dtype=np.int64), np.asarray(feature2, dtype=np.int64)
    if first.shape != second.shape or first.ndim != 1:
        raise FeatureError(f"feature1 and feature2 have shapes {first.shape} and {second.shape}, expected (N,) twice")
    if not len(first):
        return np.zeros(0, dtype=np.bool_)
    if min(first.min(), second.min()) < 0:
        raise FeatureError(f"feature numbers must not be negative, found {min(first.min(), second.min())}")
    first, second = _dense(first), _dense(second)
    mask: NDArray[np.bool_] = _walk(
        first, second, np.zeros(first.max() + 1, np.bool_), np.zeros(second.max() + 1, np.bool_)
    )
    return mask


def _dense(feature: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers that distinguish the same features and keep memory at the number of matches, (N,)."""
    if feature.max() < _SPARSE * len(feature):
        return feature
    return np.asarray(np.unique(feature, return_inverse=True)[1], np.int64)
