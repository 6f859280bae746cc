"""Which matches of a ranking remain if a feature, or a part of the image, may not be used too often.

Beyond the paper: its section 4.7 hands the ranking to an estimator as it is.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from epiprior.types import BoolArray, FloatArray, IntArray, one_to_one_mask

__all__ = ["first_of_equal", "one_to_one_mask", "spread_mask"]

_GRID = 8
_FACTORS = np.array([1.0, 0.6180339887498949, 0.7548776662466927, 0.5698402909980532])  # of no simple ratio


@numba.njit(cache=True, nogil=True)
def _walk_cells(cell1, cell2, cells, limit, wanted):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(cell1), np.bool_)
    held1 = np.zeros(cells, np.int64)
    held2 = np.zeros(cells, np.int64)
    taken = 0
    for m in range(len(cell1)):
        if taken == wanted:
            break
        i, j = cell1[m], cell2[m]
        if held1[i] < limit and held2[j] < limit:
            held1[i] += 1
            held2[j] += 1
            taken += 1
            keep[m] = True
    return keep


def first_of_equal(rows: FloatArray) -> IntArray:
    """Return where each distinct row stands first, in the order of the rows.

    Parameters
    ----------
    rows : ndarray, shape (N, D), float64
        Points or matches, 1 to 4 finite numbers each. N = 0 is allowed.

    Notes
    -----
    Equal rows have equal sums of their multiples, so that one sort of numbers finds them; rows that differ and have the
    same sum, which is as good as impossible, are told apart by a slower sort.
    """
    sums = (rows * _FACTORS[: rows.shape[1]]).sum(axis=1)
    order = np.argsort(sums, kind="stable")
    repeated = np.diff(sums[order]) == 0
    if not repeated.any():
        return np.arange(len(rows))
    ordered = rows[order]
    if (ordered[1:] != ordered[:-1])[repeated].any():
        return np.sort(np.unique(rows, axis=0, return_index=True)[1])
    return np.sort(order[np.concatenate([[True], ~repeated])])


def spread_mask(x1: FloatArray, x2: FloatArray, *, top_k: int, share: float) -> BoolArray:
    """Return the first `top_k` matches of which no cell of a grid, in either image, holds more than a share.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, best first, pixels. The grid of 8 x 8 cells covers the rectangle that they fill in each
        image.
    top_k : int
        How many are wanted; fewer come back where the cells are full.
    share : float
        Most that one cell may hold, as a share of `top_k`; at least one match.
    """
    if not len(x1):
        return np.zeros(0, dtype=np.bool_)
    limit = max(1, math.ceil(share * top_k))
    mask: BoolArray = _walk_cells(_cells(x1), _cells(x2), _GRID * _GRID, limit, top_k)
    return mask


def _cells(x: FloatArray) -> IntArray:
    low = x.min(axis=0)
    size = np.maximum(np.ptp(x, axis=0) / _GRID, 1e-9)
    column_row = np.minimum(((x - low) / size).astype(np.int64), _GRID - 1)
    cells: IntArray = column_row[:, 1] * _GRID + column_row[:, 0]
    return cells
