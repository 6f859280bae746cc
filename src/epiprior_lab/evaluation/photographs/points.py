"""Points at which an estimate is measured: control points, or points that the cameras or the F allow."""

from __future__ import annotations

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.evaluation.photographs.measures import points_on_lines
from epiprior_lab.labels.ground_truth import reference_fundamental
from epiprior_lab.pairsets import DatasetError, Pair

_GRID = 10
_GOLDEN_RATIO = 0.6180339887498949


def evaluation_points(pair: Pair) -> tuple[FloatArray, FloatArray]:
    """Return the control points of a pair, or where it has none, points that its cameras or its F allow.

    Notes
    -----
    Without control points nobody knows what the two images share. A regular grid of points of image 1 is
    then paired with points on their true epipolar lines, spread over the part of each line that image 2
    shows.

    Raises
    ------
    DatasetError
        If the pair has no control points, cameras or F, or no epipolar line meets image 2.
    """
    if pair.control_points_path is not None:
        return pair.control_points()
    if pair.fundamental_path is None and (pair.camera1 is None or pair.camera2 is None):
        raise DatasetError(f"pair {pair.pair_id!r}: neither control points nor cameras")
    F = reference_fundamental(pair)
    size1, size2 = pair.sizes()
    x1 = _grid(size1)
    lines = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    share: FloatArray = np.arange(len(x1), dtype=np.float64) * _GOLDEN_RATIO % 1.0  # spreads the points over the lines
    x2, met = points_on_lines(lines, size2, share)
    if not met.any():
        raise DatasetError(f"pair {pair.pair_id!r}: no epipolar line of image 1 meets image 2")
    return x1[met], x2[met]


def _grid(size: tuple[int, int]) -> FloatArray:
    steps = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(steps * size[0], steps * size[1])
    return np.column_stack([x.ravel(), y.ravel()])
