"""Does what is given of a pair agree: control points with images, cameras, an F, a homography."""

from __future__ import annotations

import numpy as np

from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray
from epiprior_lab.pairsets.files import DatasetError
from epiprior_lab.pairsets.homographies import transfer_distance
from epiprior_lab.pairsets.pair import Pair

FIT_PX = 3.0
_MARGIN_PX = 2.0  # reprojected and hand-made points may lie a little outside


def check_pair(pair: Pair, sizes: tuple[tuple[int, int], tuple[int, int]], where: str) -> None:
    """Check that the control points of a pair, if any, lie in their images and fit what else is given.

    Parameters
    ----------
    pair : Pair
        Its control points and matrices are read.
    sizes : tuple of tuple of int
        (width, height) of both images.
    where : str
        The row of the pair, for messages: file and line.

    Raises
    ------
    DatasetError
        If a control point lies more than 2 px outside its image, or the median distance of the control points to what
        the cameras, a given F or a given homography say is above 3 px: points of other pixels, or images in another
        order. The message names the file and line: of the point, or of the pair.
    """
    if pair.control_points_path is None:
        return
    points = pair.control_points()
    path = pair.control_points_path
    for number, (x, size) in enumerate(zip(points, sizes, strict=True), 1):
        outside = np.flatnonzero(((x < -_MARGIN_PX) | (x > np.array(size) - 1 + _MARGIN_PX)).any(axis=1))
        if len(outside):
            row = int(outside[0])
            x_text, y_text = (f"{value:g}" for value in x[row])
            raise DatasetError(
                f"{path}, line {row + 2}: point {x_text}, {y_text} lies outside image {number}, {size[0]} x {size[1]}"
            )
    distance, what = _distances(pair, *points)
    if len(distance) and not np.median(distance) <= FIT_PX:
        raise DatasetError(
            f"{where}: {what} of pair {pair.pair_id!r} does not fit its control points {path}: median distance "
            f"{np.median(distance):.1f} px, at most {FIT_PX:g} allowed"
        )


def _distances(pair: Pair, x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, str]:
    """Return the distance of each control point to the ground truth beside it, and what that is; maybe nothing."""
    H = pair.homography()
    if H is not None:
        return transfer_distance(H, x1, x2), f"the homography {pair.homography_path}"
    F = pair.fundamental()
    if F is not None:
        what = "the F of the cameras" if pair.fundamental_path is None else f"the F {pair.fundamental_path}"
        return sampson_distance(F, x1, x2), what
    return np.empty(0), ""
