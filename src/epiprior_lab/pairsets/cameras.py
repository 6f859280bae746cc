"""Pinhole cameras without distortion: ``X_camera = R X_world + t``, axes x right, y down, z forward, depth along z.

The centre of the top-left pixel is at (0, 0).
"""

from dataclasses import dataclass

import numpy as np

from epiprior.errors import EpipriorError
from epiprior.geometry import normalise_fundamental
from epiprior.types import BoolArray, Float32Array, FloatArray

_ROTATION_TOLERANCE = 1e-3  # files carry six digits
_SMOOTH_RATIO = 1.3
_DEPTH_TOLERANCE = 0.02  # relative


class CameraError(EpipriorError, ValueError):
    """A camera is impossible; the message names what is wrong with it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera: `K` (3, 3), `width`, `height` in pixels, `R` (3, 3), `t` (3,) from world to camera.

    CameraError for other shapes, a value that is not finite, no positive focal length or size, or `R` no rotation.
    """

    K: FloatArray
    R: FloatArray
    t: FloatArray
    width: int
    height: int

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise CameraError(f"{name} has shape {value.shape} or a value that is not finite, expected {shape}")
            object.__setattr__(self, name, value)
        for name, values in (
            ("image size", (self.width, self.height)),
            ("focal lengths", (self.K[0, 0], self.K[1, 1])),
        ):
            if min(values) <= 0:
                raise CameraError(f"{name} {values[0]} x {values[1]}: not positive")
        deviation = float(np.abs(self.R @ self.R.T - np.eye(3)).max())
        if deviation > _ROTATION_TOLERANCE or np.linalg.det(self.R) < 0:
            raise CameraError(f"R is not a rotation: R R' differs from 1 by {deviation:.2g}")

    @property
    def centre(self) -> FloatArray:
        """Centre of projection in the world, shape (3,)."""
        return np.asarray(-self.R.T @ self.t)

    def back_project(self, x: FloatArray, depth: FloatArray) -> FloatArray:
        """Return the world points (N, 3) seen at pixels `x` (N, 2) at `depth` (N,) along the axis."""
        rays = np.column_stack([x, np.ones(len(x))]) @ np.linalg.inv(self.K).T
        return np.asarray((rays * depth[:, None] - self.t) @ self.R)

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return pixels (N, 2), NaN at or behind the camera, and depths (N,) of world points (N, 3)."""
        seen = points @ self.R.T + self.t
        depth = seen[:, 2]
        homogeneous = seen @ self.K.T
        safe = np.where(depth > 0, depth, np.nan)
        return homogeneous[:, :2] / safe[:, None], depth


Cameras = tuple[Camera, Camera]
DepthMaps = tuple[Float32Array, Float32Array]


def reproject(camera1: Camera, camera2: Camera, x1: FloatArray, depth1: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pixels (N, 2) and depths (N,) in `camera2` of what `camera1` sees at `x1` (N, 2), `depth1` (N,) away.

    The pixels may lie outside the image, and are NaN behind the camera; the depths may be negative.
    """
    return camera2.project(camera1.back_project(x1, depth1))


def fundamental_from_cameras(camera1: Camera, camera2: Camera) -> FloatArray | None:
    """Return F with ``x2' F x1 = 0``, normalised; None where both cameras share their centre.

    Hartley and Zisserman, Multiple View Geometry, 2nd ed., equation 9.2.
    """
    R = camera2.R @ camera1.R.T
    t = camera2.t - R @ camera1.t
    if np.linalg.norm(t) <= 1e-9 * max(1.0, float(np.linalg.norm(camera1.t)), float(np.linalg.norm(camera2.t))):
        return None
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    return normalise_fundamental(np.linalg.inv(camera2.K).T @ cross @ R @ np.linalg.inv(camera1.K))


@dataclass(frozen=True, kw_only=True)
class ViewDifference:
    """How two views of a scene differ, over what both see.

    `angle_deg` is the median angle between the rays to a common point; `overlap` the part of what one image sees that
    the other sees too, the smaller of both directions; `scale_ratio` (>= 1) the median ratio of the sizes of things;
    `roll_deg` the rotation about the optical axis from image 1 to 2, in [0, 360), clockwise on the screen.
    """

    angle_deg: float
    overlap: float
    scale_ratio: float
    roll_deg: float


def depth_at(depth: Float32Array, x: FloatArray) -> FloatArray:
    """Return the depth (N,) seen at points `x` (N, 2) between the pixel centres of a depth map (height, width).

    Inverse depth is interpolated, which is exact on a plane. Where the four pixels around differ by more than 30 %, at
    an occlusion boundary, the nearest pixel decides. Inf for NaN, outside the image and where nothing is seen.
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


def covisible(cameras: Cameras, depths: DepthMaps, *, step: int = 1) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return pixels `x1` (N, 2) with a depth in the first image, their reprojections `x2`, and which are visible there.

    Every `step`-th row and column of image 1 is looked at. A point is visible where its depth differs from that of
    image 2 by less than 2 %.
    """
    rows, columns = np.nonzero(np.isfinite(depths[0][::step, ::step]))
    x1 = step * np.column_stack([columns, rows]).astype(np.float64)
    x2, predicted = reproject(*cameras, x1, depth_at(depths[0], x1))
    visible = (predicted > 0) & (np.abs(depth_at(depths[1], x2) - predicted) < _DEPTH_TOLERANCE * np.abs(predicted))
    return x1, x2, visible


def median_angle_deg(cameras: Cameras, points: FloatArray) -> float:
    """Return the median angle between the rays of two cameras to points (N, 3), degrees."""
    rays = [points - camera.centre for camera in cameras]
    cosine = (rays[0] * rays[1]).sum(axis=1) / np.prod([np.linalg.norm(ray, axis=1) for ray in rays], axis=0)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def view_difference(cameras: Cameras, depths: DepthMaps, *, step: int = 4) -> ViewDifference:
    """Return how two views differ, by every `step`-th row and column; angle and scale are NaN without common points."""
    x1, _, visible = covisible(cameras, depths, step=step)
    visible_back = covisible(cameras[::-1], depths[::-1], step=step)[2]
    parts = [float(v.mean()) if len(v) else 0.0 for v in (visible, visible_back)]
    rotation = cameras[1].R @ cameras[0].R.T
    roll = np.degrees(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])) % 360.0
    angle = scale = np.nan
    if visible.any():
        depth1 = depth_at(depths[0], x1[visible])
        points = cameras[0].back_project(x1[visible], depth1)
        angle = median_angle_deg(cameras, points)
        ratio = np.median(depth1 / cameras[1].project(points)[1]) * cameras[1].K[0, 0] / cameras[0].K[0, 0]
        scale = float(max(ratio, 1 / ratio))
    return ViewDifference(angle_deg=angle, overlap=min(parts), scale_ratio=scale, roll_deg=float(roll))
