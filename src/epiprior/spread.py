"""How much of the images the inliers cover: ten matches of one window say less than ten all over the picture.

Beyond the paper.
"""

from __future__ import annotations

import numpy as np

from epiprior.types import FloatArray

CELL_PX = 48.0  # the reach of a few features, as in `epiprior.estimators.epiprior_evidence`


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
