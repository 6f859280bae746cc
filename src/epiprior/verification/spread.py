"""How much of the images the inliers cover: ten matches of one window say less than ten all over the picture.

Beyond the paper.
"""

from __future__ import annotations

import numpy as np

from epiprior.types import FloatArray, IntArray

CELL_PX = 48.0  # the reach of a few features


def spread_of(x1: FloatArray, x2: FloatArray) -> int:
    """Return in how many cells of 48 x 48 pixels the points lie: of the two images the fewer.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels.

    Returns
    -------
    int
        From 0, without any match, to N.
    """
    return min(len(np.unique(np.floor(x / CELL_PX), axis=0)) for x in (x1, x2))


def spread_groups(x1: FloatArray, x2: FloatArray) -> IntArray:
    """Return a number for each match, the same for those that lead from one cell to one cell: shape (N,), >= 0.

    Cells have 48 pixels, the reach of a few features.
    """
    cells = np.floor(np.hstack([x1, x2]) / CELL_PX).astype(np.int64)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
