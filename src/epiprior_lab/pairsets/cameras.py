"""Pinhole cameras without distortion, and what follows from two of them.

Conventions: world-to-camera ``X_camera = R X_world + t``, OpenCV axes (x right, y down, z forward), the
centre of the top-left pixel at (0, 0); depth is z along the optical axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.errors import EpipriorError
from epiprior.geometry import normalise_fundamental
from epiprior.types import FloatArray

_ROTATION_TOLERANCE = 1e-3  # files carry six digits


class CameraError(EpipriorError, ValueError):
    """A camera is impossible; the message names what is wrong with it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera.

    Parameters
    ----------
    K : ndarray, shape (3, 3), float64
        Calibration, pixels; upper triangular, last row (0, 0, 1).
    R : ndarray, shape (3, 3), float64
        Rotation from world to camera.
    t : ndarray, shape (3,), float64
        Translation from world to camera, world units.
    width, height : int
        Image size, pixels.

    Raises
    ------
    CameraError
        If a shape is another, a value is not finite, the focal length or size is not positive, or `R` is no
        rotation.
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
        if self.width <= 0 or self.height <= 0:
            raise CameraError(f"image size {self.width} x {self.height} is not positive")
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CameraError(f"focal lengths {self.K[0, 0]}, {self.K[1, 1]} are not positive")
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


def reproject(camera1: Camera, camera2: Camera, x1: FloatArray, depth1: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where, and at which depth, `camera2` sees what `camera1` sees at `x1`.

    Parameters
    ----------
    camera1, camera2 : Camera
        The two cameras.
    x1 : ndarray, shape (N, 2), float64
        Pixels of image 1.
    depth1 : ndarray, shape (N,), float64
        Depth at `x1`; finite and positive.

    Returns
    -------
    x2 : ndarray, shape (N, 2)
        Pixels of image 2, maybe outside the image; NaN behind the camera.
    depth2 : ndarray, shape (N,)
        Depth in camera 2, maybe negative.
    """
    return camera2.project(camera1.back_project(x1, depth1))


def fundamental_from_cameras(camera1: Camera, camera2: Camera) -> FloatArray | None:
    """Return F with ``x2' F x1 = 0``, normalised; None where both cameras share their centre.

    References
    ----------
    Hartley and Zisserman, Multiple View Geometry, 2nd ed., equation 9.2.
    """
    R = camera2.R @ camera1.R.T
    t = camera2.t - R @ camera1.t
    if np.linalg.norm(t) <= 1e-9 * max(1.0, float(np.linalg.norm(camera1.t)), float(np.linalg.norm(camera2.t))):
        return None
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    return normalise_fundamental(np.linalg.inv(camera2.K).T @ cross @ R @ np.linalg.inv(camera1.K))
