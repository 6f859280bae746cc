"""Descriptors of features: at a fixed orientation (paper, section 4.2), and normalised (section 4.1)."""

import numpy as np

from epiprior.features.images import Photograph
from epiprior.features.scale_space import FIRST_OCTAVE, LAYERS, level_of, octave_levels
from epiprior.kernels.descriptor import describe_level
from epiprior.kernels.parallel import in_threads
from epiprior.types import Features, Float32Array, FloatArray, IntArray

_CHUNK = 1_000


def describe_frames(photograph: Photograph, frames: FloatArray) -> Float32Array:
    """Return SIFT descriptors of `frames` (x, y, sigma, orientation in degrees), shape (N, 128), working pixels.

    They are nearly OpenCV's (`epiprior.kernels.descriptor`), on a scale space that is built once per photograph.
    """
    descriptors = np.empty((len(frames), 128), np.float32)
    octave, layer = level_of(photograph, frames[:, 2])
    scaled = frames * np.column_stack([*[0.5**octave] * 3, np.full(len(frames), np.pi / 180)])
    work: list[tuple[Float32Array, IntArray]] = []
    for k in range(FIRST_OCTAVE, int(octave.max(initial=FIRST_OCTAVE - 1)) + 1):
        levels = octave_levels(photograph, k)
        for level in range(LAYERS):
            rows = np.flatnonzero((octave == k) & (layer == level + 1))
            work += [(levels[level], rows[first : first + _CHUNK]) for first in range(0, len(rows), _CHUNK)]
    in_threads(lambda one: describe_level(one[0].ravel(), *one[0].shape, scaled, one[1], descriptors), work)
    return descriptors


def describe_at_orientation(photograph: Photograph, features: Features, orientation_deg: float) -> Float32Array:
    """Return descriptors, (N, 128), with every orientation fixed to one angle (section 4.2, generalised upright SIFT).

    The angle is in degrees, clockwise on the screen; `features` are in pixels of the image as given. The descriptors
    are not normalised, and read-only: the photograph keeps them.
    """
    frames = _frames_at(photograph, features, orientation_deg)
    key = frames.tobytes()
    if key not in photograph.described:
        descriptors = describe_frames(photograph, frames)
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
