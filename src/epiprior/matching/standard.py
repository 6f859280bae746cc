"""Step 2: standard putative matches X_L with distance ratios and X_B with similarity weights (paper, section 4.1)."""

from dataclasses import dataclass

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray

_BLOCK, _STRIP = 256, 32


@dataclass(frozen=True)
class Neighbours:
    """The two most similar descriptors of the other image, for each descriptor of one image."""

    nearest: IntArray  # (N,), index of the most similar one; -1 where the other image has none
    best: Float32Array  # (N,), the highest similarity, in [-1, 1]; -1 where there is none
    second: Float32Array  # (N,), the second highest

    @property
    def distance_ratio(self) -> FloatArray:
        """Ratio d_r = arccos(m_k) / arccos(m_k2), in [0, 1]; 1 where both angles vanish."""
        angle = np.arccos(np.clip(self.best.astype(np.float64), -1.0, 1.0))
        angle2 = np.arccos(np.clip(self.second.astype(np.float64), -1.0, 1.0))
        return np.divide(angle, angle2, out=np.ones_like(angle), where=angle2 > 0)


@compiled
def _update_two_best(S, row0, nearest1, best1, second1, nearest2, best2, second2):  # type: ignore[no-untyped-def]
    """Enter a block of similarities, rows `row0` onward, into the two best of both sides; ties keep the lower index.

    Most strips of a row hold nothing above a second best of either side, which vector instructions tell.
    """
    count = S.shape[1]
    for r in range(S.shape[0]):
        i = row0 + r
        for first in range(0, count, _STRIP):
            last = min(first + _STRIP, count)
            second, above = second1[i], np.int32(0)
            for j in range(first, last):
                above += np.int32(S[r, j] > min(second, second2[j]))
            if above == 0:
                continue
            for j in range(first, last):
                v = S[r, j]
                if v > best1[i]:
                    second1[i], best1[i], nearest1[i] = best1[i], v, j
                elif v > second1[i]:
                    second1[i] = v
                if v > best2[j]:
                    second2[j], best2[j], nearest2[j] = best2[j], v, i
                elif v > second2[j]:
                    second2[j] = v


def nearest_neighbours(d1: Float32Array, d2: Float32Array) -> tuple[Neighbours, Neighbours]:
    """Return the neighbours of each unit descriptor of image 1 in image 2, and the other way round (exhaustive)."""
    sides = [
        (np.full(n, -1, np.int64), np.full(n, -1.0, np.float32), np.full(n, -1.0, np.float32))
        for n in (len(d1), len(d2))
    ]
    if len(d1) and len(d2):
        # One block of memory for all: fresh memory costs as much as the products.
        block = np.empty((_BLOCK, len(d2)), np.float32)
        for row0 in range(0, len(d1), _BLOCK):
            rows = d1[row0 : row0 + _BLOCK]
            _update_two_best(np.matmul(rows, d2.T, out=block[: len(rows)]), row0, *sides[0], *sides[1])
    return Neighbours(*sides[0]), Neighbours(*sides[1])


def mutual_mask(forward: Neighbours, backward: Neighbours) -> BoolArray:
    """Return which descriptors of image 1 are the nearest neighbour of their nearest neighbour, shape (N1,)."""
    if not len(forward.nearest) or not len(backward.nearest):
        return np.zeros(len(forward.nearest), bool)
    return np.asarray(backward.nearest[forward.nearest] == np.arange(len(forward.nearest)), dtype=bool)


def similarity_weights(forward: Neighbours, backward: Neighbours) -> FloatArray:
    """Return the similarity weight t_k of each descriptor of image 1 with its nearest neighbour, shape (N1,), >= 0.

    t_k = (1 - exp(-m_k))^2 (1 - m_k1 / m_k) (1 - m_k2 / m_k), where m_k1 and m_k2 are the second highest similarities
    among the features of image 1 and of image 2 (section 4.1, after BLOGS by Brahmachari and Sarkar). It is 0 where the
    nearest neighbour is not mutual, or m_k <= 0. Other similarities below zero count as zero.
    """
    weights = np.zeros(len(forward.nearest))
    keep = np.flatnonzero(mutual_mask(forward, backward) & (forward.best > 0))
    m = forward.best[keep].astype(np.float64)
    m2 = np.clip(forward.second[keep], 0.0, None).astype(np.float64)
    m1 = np.clip(backward.second[forward.nearest[keep]], 0.0, None).astype(np.float64)
    weights[keep] = (1 - np.exp(-m)) ** 2 * np.clip(1 - m1 / m, 0, 1) * np.clip(1 - m2 / m, 0, 1)
    return weights


@dataclass(frozen=True)
class StandardTable:
    """X_L and X_B together, one row per distinct pair of locations, ascending; all of shape (S,).

    A distance ratio d_r is 1 where the match is not the nearest in that direction, or d_r from image 1 to 2 is above
    the limit of X_L.
    """

    location1: IntArray
    location2: IntArray
    distance_ratio: FloatArray  # from image 1 to 2
    distance_ratio_backward: FloatArray  # from image 2 to 1
    similarity_weight: FloatArray  # t_k; 0 where the match is not in X_B
    mutual: BoolArray  # whether the match is in X_B


def standard_table(
    forward: Neighbours, backward: Neighbours, location_of: tuple[IntArray, IntArray], max_distance_ratio: float
) -> StandardTable:
    """Collect X_L (d_r up to the limit) and X_B (mutual nearest neighbours) by location (section 4.1).

    Of several features at one location the best counts: lowest d_r, highest t_k.
    """
    of1, of2 = location_of
    width = int(of2.max(initial=0)) + 1
    mutual = mutual_mask(forward, backward)
    ratio = np.where(forward.distance_ratio <= max_distance_ratio, forward.distance_ratio, 1.0)
    chosen = np.flatnonzero((forward.nearest >= 0) & (mutual | (ratio < 1.0)))
    keys, row = np.unique(of1[chosen] * width + of2[forward.nearest[chosen]], return_inverse=True)
    row = row.reshape(-1)
    best_ratio, best_backward = np.ones(len(keys)), np.ones(len(keys))
    best_weight, is_mutual = np.zeros(len(keys)), np.zeros(len(keys), bool)
    np.minimum.at(best_ratio, row, ratio[chosen])
    np.maximum.at(best_weight, row, similarity_weights(forward, backward)[chosen])
    np.logical_or.at(is_mutual, row, mutual[chosen])
    if len(keys):
        back_keys = of1[backward.nearest] * width + of2
        place = np.minimum(np.searchsorted(keys, back_keys), len(keys) - 1)
        known = keys[place] == back_keys
        np.minimum.at(best_backward, place[known], backward.distance_ratio[known])
    return StandardTable(keys // width, keys % width, best_ratio, best_backward, best_weight, is_mutual)
