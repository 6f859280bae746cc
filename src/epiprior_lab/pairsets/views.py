"""What two cameras see in common, from their depth maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.pairsets.cameras import Camera, reproject

_SMOOTH_RATIO = 1.3


@dataclass(frozen=True, kw_only=True)
class ViewDifference:
    """How two views of a scene differ, over what both see.

    Parameters
    ----------
    angle_deg : float
        Median angle between the two rays to a common point, degrees.
    overlap : float
        Part of what one image sees that the other sees too, the smaller of both directions, in [0, 1].
    scale_ratio : float
        Median ratio of the sizes of things, larger over smaller, >= 1.
    roll_deg : float
        Rotation about the optical axis from image 1 to image 2, degrees in [0, 360), clockwise on the screen.
    """

    angle_deg: float
    overlap: float
    scale_ratio: float
    roll_deg: float


def depth_at(depth: Float32Array, x: FloatArray) -> FloatArray:
    """Return the depth seen at points between pixel centres.

    Parameters
    ----------
    depth : ndarray, shape (height, width), float32
        Depth at pixel centres, inf where nothing is seen.
    x : ndarray, shape (N, 2), float64
        Points, pixels; they may lie outside or be NaN.

    Returns
    -------
    ndarray, shape (N,), float64
        Inverse depth is interpolated, which is exact on a plane. Where the four pixels around differ by more than
        30 %, at the rim of something, the nearest pixel decides. Inf outside the image and where nothing is seen.
    """
    height, width = depth.shape
    # Clipped before the conversion to integers, which is undefined for huge numbers and NaN.
    clipped = np.clip(np.nan_to_num(x, nan=-9.0), -9.0, 1e6)
    column, row = np.rint(clipped).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    values = np.full(len(x), np.inf)
    values[inside] = depth[row[inside], column[inside]]
    corner = np.clip(np.floor(clipped).astype(np.int64), 0, (width - 2, height - 2)).T
    a, b = np.clip(clipped.T - corner, 0.0, 1.0)
    four = [depth[corner[1] + dy, corner[0] + dx].astype(np.float64) for dy in (0, 1) for dx in (0, 1)]
    smooth = inside & (np.maximum.reduce(four) < _SMOOTH_RATIO * np.minimum.reduce(four))
    weights = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    inverse = sum(weight / value for weight, value in zip(weights, four, strict=True))
    values[smooth] = 1.0 / np.asarray(inverse)[smooth]
    return values


def covisible(
    cameras: tuple[Camera, Camera],
    depths: tuple[Float32Array, Float32Array],
    *,
    step: int = 1,
    depth_tolerance: float = 0.02,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return what the first image sees, where it falls in the second, and whether it is visible there.

    Parameters
    ----------
    cameras, depths : tuples
        Of both images.
    step : int, default 1
        Every how many pixels of image 1 to look.
    depth_tolerance : float, default 0.02
        Relative difference of depth below which a point counts as visible.

    Returns
    -------
    x1, x2 : ndarray, shape (N, 2)
        Pixels at which image 1 has a depth, and their reprojections.
    visible : ndarray, shape (N,), bool
        True where image 2 sees the same point.
    """
    rows, columns = np.nonzero(np.isfinite(depths[0][::step, ::step]))
    x1 = step * np.column_stack([columns, rows]).astype(np.float64)
    x2, predicted = reproject(*cameras, x1, depth_at(depths[0], x1))
    visible = (predicted > 0) & (np.abs(depth_at(depths[1], x2) - predicted) < depth_tolerance * np.abs(predicted))
    return x1, x2, visible


def view_difference(
    cameras: tuple[Camera, Camera], depths: tuple[Float32Array, Float32Array], *, step: int = 4
) -> ViewDifference:
    """Return how two views differ; angle and scale are NaN where they have nothing in common.

    Parameters
    ----------
    cameras, depths : tuples
        Of both images.
    step : int, default 4
        Every how many pixels to look.
    """
    x1, _, visible = covisible(cameras, depths, step=step)
    visible_back = covisible(cameras[::-1], depths[::-1], step=step)[2]
    parts = [float(v.mean()) if len(v) else 0.0 for v in (visible, visible_back)]
    rotation = cameras[1].R @ cameras[0].R.T
    roll = np.degrees(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])) % 360.0
    angle = scale = np.nan
    if visible.any():
        depth1 = depth_at(depths[0], x1[visible])
        points = cameras[0].back_project(x1[visible], depth1)
        rays = [points - camera.centre for camera in cameras]
        cosine = (rays[0] * rays[1]).sum(axis=1) / np.prod([np.linalg.norm(ray, axis=1) for ray in rays], axis=0)
        angle = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))
        ratio = np.median(depth1 / cameras[1].project(points)[1]) * cameras[1].K[0, 0] / cameras[0].K[0, 0]
        scale = float(max(ratio, 1 / ratio))
    return ViewDifference(angle_deg=angle, overlap=min(parts), scale_ratio=scale, roll_deg=float(roll))
