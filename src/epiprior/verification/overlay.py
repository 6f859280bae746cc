"""Matches on what does not move with the scene: a watermark, also a tiled one, a time stamp, the bars of a screen.

Two unrelated photographs that carry the same overlay match there, feature by feature. Any F of a pure translation
explains matches that stay in place, and one along its epipolar lines those from tile to tile; the two numbers that are
left are fitted to chance. COLMAP calls such pairs watermarks, where the matches are a translation at the border.
"""

import numpy as np
from scipy.spatial import cKDTree

from epiprior.types import BoolArray, FloatArray
from epiprior.verification.measures import CELL_PX

_SAME_PX = 1.0
_RING_PX = (2.0, 5.0)
_MIN_REPEATED = 3


def share_in_place(x1: FloatArray, x2: FloatArray) -> float:
    """Return which share of matches (N, 2) stays in place, within 1 px; 0 without matches."""
    return float(np.mean(np.linalg.norm(x2 - x1, axis=1) <= _SAME_PX)) if len(x1) else 0.0


def apart_from_overlay(x1: FloatArray, x2: FloatArray) -> BoolArray:
    """Return which matches, shape (N, 2), working pixels, lie elsewhere than on an overlay: all, where there is none.

    There is an overlay where at least 3 matches stay in place, within 1 px, and more than are displaced by 2 to 5 px:
    displacements of a scene are spread out, those of an overlay are not. All displacements that are as frequent and as
    isolated count as the overlay's. Matches of which both ends lie within 48 px of it say nothing about the scene.
    """
    moved = x2 - x1
    length = np.linalg.norm(moved, axis=1)
    still = np.count_nonzero(length <= _SAME_PX)
    around = np.count_nonzero((length > _RING_PX[0]) & (length <= _RING_PX[1]))
    if still < _MIN_REPEATED or still <= around:
        return np.ones(len(x1), np.bool_)
    tree = cKDTree(moved)
    same, inner, outer = (tree.query_ball_point(moved, px, return_length=True) for px in (_SAME_PX, *_RING_PX))
    repeated = (same >= _MIN_REPEATED) & (same > outer - inner)
    overlay = cKDTree(np.vstack([x1[repeated], x2[repeated]]))
    return np.asarray(np.maximum(overlay.query(x1)[0], overlay.query(x2)[0]) > CELL_PX)
