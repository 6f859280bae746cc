"""Step 1: local features of a photograph (paper, section 4.1).

Locations and scales are pixels of the image as given, whatever size it is worked on at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError, SettingsError
from epiprior.features.images import Photograph
from epiprior.types import Features, Float32Array, FloatArray, IntArray

# The stubs of OpenCV lack the factories of detectors.
_detectors: Any = cv2
_MIN_IMAGE_SIDE = 16


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """How features are found and described.

    Parameters
    ----------
    detector : str
        ``sift`` (OpenCV), or ``colmap-sift`` (VLFeat's, through pycolmap).
    max_image_size : int
        Longer side at which the image is worked on, pixels, >= 64.
    max_keypoints : int
        Number of strongest features kept, >= 8.
    root : bool
        RootSIFT (Arandjelovic and Zisserman, 2012): the square root of the L1-normalised descriptor.
    centred : bool
        Subtract the descriptor's mean, so that the inner product is the normalised cross-correlation.
    """

    detector: str = "sift"
    max_image_size: int = 1024
    max_keypoints: int = 4000
    root: bool = True
    centred: bool = True

    def __post_init__(self) -> None:
        if self.detector not in DETECTORS:
            raise SettingsError(f"detector is {self.detector!r}, known: {', '.join(sorted(DETECTORS))}")
        if self.max_image_size < 64:
            raise SettingsError(f"max_image_size is {self.max_image_size}, must be at least 64")
        if self.max_keypoints < 8:
            raise SettingsError(f"max_keypoints is {self.max_keypoints}, must be at least 8")


def detect_features(photograph: Photograph, settings: FeatureSettings | None = None) -> Features:
    """Find features and describe them at their own orientation.

    Parameters
    ----------
    photograph : Photograph
        The working image.
    settings : FeatureSettings, optional
        Detector and limits.

    Returns
    -------
    Features
        In pixels of the image as given, none where it is transparent. Empty for an image without texture or smaller
        than 16 pixels.
    """
    settings = settings or FeatureSettings()
    if min(photograph.grey.shape) < _MIN_IMAGE_SIDE:
        return _as_features(photograph, np.empty((0, 4)), np.empty((0, 128), np.float32))
    frames, descriptors = DETECTORS[settings.detector](photograph.grey, settings.max_keypoints)
    shown = photograph.shows(frames[:, :2])
    return _as_features(photograph, frames[shown], descriptors[shown])


def _as_features(photograph: Photograph, frames: FloatArray, descriptors: Float32Array) -> Features:
    """Make Features of frames (x, y, sigma, orientation in degrees) in working pixels."""
    return Features(
        xy=photograph.to_given(frames[:, :2]),
        scale=frames[:, 2] * photograph.factor,
        orientation_deg=np.mod(frames[:, 3], 360.0),
        descriptors=descriptors,
        image_size=photograph.size,
    )


def _frames_of(keypoints: tuple[Any, ...]) -> FloatArray:
    frames = np.array([(*k.pt, k.size / 2, k.angle) for k in keypoints], dtype=np.float64)
    return frames.reshape(-1, 4)


def _detect_sift(grey: NDArray[np.uint8], limit: int) -> tuple[FloatArray, Float32Array]:
    # Without the precise upscaling OpenCV's keypoints are biased by a quarter of a pixel.
    sift = _detectors.SIFT_create(nfeatures=limit, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(grey, None)
    if not keypoints:
        return np.empty((0, 4)), np.empty((0, 128), np.float32)
    return _frames_of(keypoints), descriptors


def _detect_colmap_sift(grey: NDArray[np.uint8], limit: int) -> tuple[FloatArray, Float32Array]:
    try:
        import pycolmap
    except ImportError as error:
        raise FeatureError("the detector colmap-sift needs pycolmap: pip install 'pycolmap>=4,<5'") from error
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = limit
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, found = extractor.extract(pycolmap.Bitmap.from_array(grey))
    frames = np.asarray(pycolmap.keypoints_to_matrix(keypoints), dtype=np.float64).reshape(-1, 4)
    # COLMAP's origin is the corner of the top-left pixel; its descriptors are square roots of L1-normalised ones.
    frames[:, :2] -= 0.5
    frames[:, 3] = np.rad2deg(frames[:, 3])
    return frames, np.square(np.asarray(found.data, dtype=np.float32).reshape(-1, 128))


DETECTORS: dict[str, Callable[[NDArray[np.uint8], int], tuple[FloatArray, Float32Array]]] = {
    "sift": _detect_sift,
    "colmap-sift": _detect_colmap_sift,
}


def unique_locations(features: Features) -> tuple[IntArray, IntArray]:
    """Find the features that differ only in orientation.

    SIFT gives several orientations at one location and scale; at a fixed orientation those twins are identical.

    Returns
    -------
    first : ndarray, shape (M,), int64
        Index of the first feature of each (location, scale), ascending; the detector lists the strongest first.
    location : ndarray, shape (N,), int64
        For each feature, the index into `first` of its (location, scale).
    """
    if not len(features):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    key = np.column_stack([features.xy, features.scale])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return first[order].astype(np.int64), rank[inverse.reshape(-1)]
