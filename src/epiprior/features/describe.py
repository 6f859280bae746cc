"""Descriptors of features: at a fixed orientation (paper, section 4.2), and normalised (section 4.1)."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError
from epiprior.features.images import Photograph
from epiprior.types import Features, Float32Array, FloatArray

# Lowe's pyramid as OpenCV and VLFeat build it: sigma of its base, layers of an octave.
_BASE_SIGMA = 1.6
_LAYERS = 3


def describe_frames(grey: NDArray[np.uint8], frames: FloatArray) -> Float32Array:
    """Return SIFT descriptors of `frames` (x, y, sigma, orientation in degrees), shape (N, 128), working pixels."""
    if not len(frames):
        return np.empty((0, 128), np.float32)
    x, y, sigma, angle = frames.T
    # Which level of the pyramid a sigma belongs to, packed as OpenCV packs it: octave, layer.
    level = _LAYERS * np.log2(np.maximum(sigma, 1e-3) / _BASE_SIGMA)
    last = int(np.log2(min(grey.shape))) - 2
    octave = np.clip(np.floor((level - 0.5) / _LAYERS), -1, max(last, 0)).astype(int)
    layer = np.clip(np.rint(level - _LAYERS * octave), 1, _LAYERS).astype(int)
    packed = (octave & 255) | (layer << 8)
    columns = (x, y, 2 * sigma, np.mod(angle, 360.0), packed)
    keypoints = [
        cv2.KeyPoint(px, py, size, turn, 0.0, pack)
        for px, py, size, turn, pack in zip(*(c.tolist() for c in columns), strict=True)
    ]
    opencv: Any = cv2  # its stubs lack the factories of detectors
    kept, descriptors = opencv.SIFT_create(enable_precise_upscale=True).compute(grey, keypoints)
    if descriptors is None or len(kept) != len(frames):
        raise FeatureError(f"SIFT described {len(kept)} of {len(frames)} features; are they inside the image?")
    return np.asarray(descriptors, dtype=np.float32)


def describe_at_orientation(photograph: Photograph, features: Features, orientation_deg: float) -> Float32Array:
    """Return descriptors, (N, 128), with every orientation fixed to one angle (section 4.2, generalised upright SIFT).

    The angle is in degrees, clockwise on the screen; `features` are in pixels of the image as given. The descriptors
    are not normalised, and read-only: the photograph keeps them.
    """
    frames = _frames_at(photograph, features, orientation_deg)
    key = frames.tobytes()
    if key not in photograph.described:
        descriptors = describe_frames(photograph.pixels(), frames)
        descriptors.flags.writeable = False
        photograph.described[key] = descriptors
    return photograph.described[key]


def remember_description(
    photograph: Photograph, features: Features, orientation_deg: float, descriptors: Float32Array
) -> None:
    """Give a photograph what `describe_at_orientation` has returned for the same arguments in an earlier run."""
    photograph.described[_frames_at(photograph, features, orientation_deg).tobytes()] = descriptors


def _frames_at(photograph: Photograph, features: Features, orientation_deg: float) -> FloatArray:
    angle = np.full(len(features), orientation_deg)
    return np.column_stack([photograph.to_working(features.xy), features.scale / photograph.factor, angle])


def normalise_descriptors(descriptors: Float32Array, *, root: bool, centred: bool) -> Float32Array:
    """Return unit descriptors, whose inner product is the similarity (section 4.1); `FeatureSettings` tells the forms.

    Shape (N, D), as given; for `root` they must not be negative. A descriptor without any contrast stays zero.
    """
    d = np.asarray(descriptors, dtype=np.float32)
    if root:
        total = np.abs(d).sum(axis=1, keepdims=True)
        d = np.sqrt(np.maximum(d, 0.0) / np.maximum(total, 1e-12))
    if centred and d.size:
        d = d - d.mean(axis=1, keepdims=True)
    norm = np.sqrt(np.einsum("ij,ij->i", d, d))[:, None]
    return np.ascontiguousarray(d / np.maximum(norm, 1e-12), dtype=np.float32)
