"""Step 2: standard putative matches X_L with distance ratios and X_B with similarity weights (paper, section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray

_BLOCK = 512


@dataclass(frozen=True)
class Neighbours:
    """The two most similar descriptors of the other image, for each descriptor of one image.

    Parameters
    ----------
    nearest : ndarray, shape (N,), int64
        Index of the most similar one; -1 where the other image has none.
    best, second : ndarray, shape (N,), float32
        The highest and the second highest similarity, in [-1, 1]; -1 where there is none.
    """

    nearest: IntArray
    best: Float32Array
    second: Float32Array

    @property
    def distance_ratio(self) -> FloatArray:
        """Ratio d_r = arccos(m_k) / arccos(m_k2), in [0, 1]; 1 where both angles vanish."""
        angle = np.arccos(np.clip(self.best.astype(np.float64), -1.0, 1.0))
        angle2 = np.arccos(np.clip(self.second.astype(np.float64), -1.0, 1.0))
        return np.divide(angle, angle2, out=np.ones_like(angle), where=angle2 > 0)


@numba.njit(cache=True, nogil=True)
def _update_two_best(S, row0, nearest1, best1, second1, nearest2, best2, second2):  # type: ignore[no-untyped-def]
    """Enter a block of similarities, rows `row0` onward, into the two best of both sides; ties keep the lower index."""
    for r in range(S.shape[0]):
        i = row0 + r
        b, s, k = best1[i], second1[i], nearest1[i]
        for j in range(S.shape[1]):
            v = S[r, j]
            if v > b:
                s, b, k = b, v, j
            elif v > s:
                s = v
            if v > best2[j]:
                second2[j] = best2[j]
                best2[j] = v
                nearest2[j] = i
            elif v > second2[j]:
                second2[j] = v
        best1[i], second1[i], nearest1[i] = b, s, k


def nearest_neighbours(d1: Float32Array, d2: Float32Array) -> tuple[Neighbours, Neighbours]:
    """Search both directions exhaustively, by blocks.

    Parameters
    ----------
    d1, d2 : ndarray, shapes (N1, D) and (N2, D), float32
        Unit descriptors.

    Returns
    -------
    tuple of Neighbours
        For each descriptor of image 1 in image 2, and the other way round.
    """
    sides = []
    for n in (len(d1), len(d2)):
        sides.append((np.full(n, -1, np.int64), np.full(n, -1.0, np.float32), np.full(n, -1.0, np.float32)))
    if len(d1) and len(d2):
        for row0 in range(0, len(d1), _BLOCK):
            _update_two_best(d1[row0 : row0 + _BLOCK] @ d2.T, row0, *sides[0], *sides[1])
    return Neighbours(*sides[0]), Neighbours(*sides[1])


def mutual_mask(forward: Neighbours, backward: Neighbours) -> BoolArray:
    """Return which descriptors of image 1 are the nearest neighbour of their nearest neighbour, shape (N1,)."""
    if not len(forward.nearest) or not len(backward.nearest):
        return np.zeros(len(forward.nearest), bool)
    return np.asarray(backward.nearest[forward.nearest] == np.arange(len(forward.nearest)), dtype=bool)


def similarity_weights(forward: Neighbours, backward: Neighbours) -> FloatArray:
    """Return the similarity weight t_k of each descriptor of image 1 with its nearest neighbour.

    t_k = (1 - exp(-m_k))^2 (1 - m_k1 / m_k) (1 - m_k2 / m_k), where m_k1 and m_k2 are the second highest similarities
    among the features of image 1 and of image 2.

    Returns
    -------
    ndarray, shape (N1,), float64
        >= 0; 0 where the nearest neighbour is not mutual, or m_k <= 0, for which t_k means nothing. Similarities
        below zero count as zero.

    References
    ----------
    Paper, section 4.1, after Brahmachari and Sarkar (BLOGS).
    """
    weights = np.zeros(len(forward.nearest))
    keep = np.flatnonzero(mutual_mask(forward, backward) & (forward.best > 0))
    m = forward.best[keep].astype(np.float64)
    m2 = np.clip(forward.second[keep], 0.0, None).astype(np.float64)
    m1 = np.clip(backward.second[forward.nearest[keep]], 0.0, None).astype(np.float64)
    weights[keep] = (1 - np.exp(-m)) ** 2 * np.clip(1 - m1 / m, 0, 1) * np.clip(1 - m2 / m, 0, 1)
    return weights
