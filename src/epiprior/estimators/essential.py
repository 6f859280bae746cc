"""An F under known intrinsics: that of the essential matrix of the matches which an F without them collected.

F has two degrees of freedom more, which it bends where the right matches are few or lie nearly in one plane: it then
collects wrong ones beside them. An essential matrix of the same matches is often right where F is not.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from epiprior.errors import EstimatorError, require
from epiprior.geometry import normalise_fundamental
from epiprior.types import FloatArray

WORTH = 0.02  # the confidence of an F below which no essential matrix is looked for: of unrelated images, mostly
_COLMAP_PX = 4.0


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """What is known of the camera of an image.

    Parameters
    ----------
    K : (3, 3) float64. Calibration matrix, in pixels of the image; the centre of the top-left pixel is at (0, 0).
    undistort : Takes the distortion of the lens out of points, (N, 2), pixels; None where there is none.
    """

    K: FloatArray
    undistort: Callable[[FloatArray], FloatArray] | None = None

    def in_working_pixels(self, factor: float) -> "Intrinsics":
        """Return the same for an image that is `factor` times smaller."""
        whole = self.undistort
        undistort = None if whole is None else lambda x: whole(x * factor) / factor
        return Intrinsics(K=np.diag([1 / factor, 1 / factor, 1.0]) @ self.K, undistort=undistort)


def essential_matrices(
    x1: FloatArray, x2: FloatArray, K1: FloatArray, K2: FloatArray, *, threshold_px: float, seed: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield essential matrices of matches, (N, 2), that need no undistortion, and their F; each (3, 3).

    One with the threshold of the estimator, and one with COLMAP's, 4 pixels, which holds where few matches are exact.
    Both are pycolmap's, refined. EstimatorError if it is not installed.
    """
    pycolmap = require("pycolmap", "known intrinsics", EstimatorError)
    cameras = [_pinhole(K, x) for K, x in ((K1, x1), (K2, x2))]
    options = pycolmap.TwoViewGeometryOptions().ransac
    options.random_seed = seed % 2**31
    for limit in (threshold_px, _COLMAP_PX):
        options.max_error = limit
        found = pycolmap.estimate_essential_matrix(x1, x2, *cameras, options)
        if found is None:
            continue
        pose = found["cam2_from_cam1"]
        refined = pycolmap.refine_relative_pose(pose, cameras[0], x1, cameras[1], x2, found["inlier_mask"])
        E = pycolmap.essential_matrix_from_pose(pose if refined is None else refined["cam2_from_cam1"])
        F = normalise_fundamental(np.linalg.inv(K2).T @ E @ np.linalg.inv(K1))
        if F is not None:
            yield np.asarray(E, np.float64), F


def _pinhole(K: FloatArray, x: FloatArray) -> Any:
    import pycolmap

    width, height = np.maximum(np.ceil(x.max(axis=0, initial=1.0)), 1.0)
    camera = pycolmap.Camera.create_from_model_name(0, "PINHOLE", 1.0, int(width), int(height))
    camera.params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    return camera
