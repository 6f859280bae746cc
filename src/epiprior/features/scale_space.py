"""The Gaussian scale space of a photograph, as OpenCV builds it for SIFT: the levels that descriptors are taken from.

References: Lowe, IJCV 2004, section 3. The constants and the order of the steps are those of OpenCV's SIFT with precise
upscaling: an image of twice the size first, octaves of half the size each.
"""

import math

import cv2
import numpy as np

from epiprior.features.images import Photograph
from epiprior.types import Float32Array, FloatArray, IntArray

LAYERS = 3  # of an octave that descriptors are taken from, numbered from 1
FIRST_OCTAVE = -1
_BASE_SIGMA, _CAMERA_SIGMA = 1.6, 0.5
_FACTOR = 2.0 ** (1 / LAYERS)


def level_of(photograph: Photograph, sigma: FloatArray) -> tuple[IntArray, IntArray]:
    """Return octave and layer that features of a scale, (N,), working pixels, belong to."""
    level = LAYERS * np.log2(np.maximum(sigma, 1e-3) / _BASE_SIGMA)
    last = max(int(math.log2(min(photograph.grey.shape))) - 2, 0)
    octave = np.clip(np.floor((level - 0.5) / LAYERS), FIRST_OCTAVE, last).astype(np.int64)
    return octave, np.clip(np.rint(level - LAYERS * octave), 1, LAYERS).astype(np.int64)


def octave_levels(photograph: Photograph, octave: int) -> list[Float32Array]:
    """Return the levels 1 to 3 of an octave, whose pixels are ``2**octave`` working pixels; the photograph keeps them.

    Pixel centres are integers times that in working pixels: OpenCV's octaves keep pixel (0, 0) in place.
    """
    for k in range(FIRST_OCTAVE, octave + 1):
        if k not in photograph.octaves:
            image = _doubled(photograph) if k == FIRST_OCTAVE else _halved(photograph.octaves[k - 1][-1])
            levels = []
            for layer in range(LAYERS):
                before = _BASE_SIGMA * _FACTOR**layer
                image = _blurred(image, math.sqrt((before * _FACTOR) ** 2 - before**2))
                levels.append(image)
            photograph.octaves[k] = levels
    return photograph.octaves[octave]


def _doubled(photograph: Photograph) -> Float32Array:
    height, width = photograph.grey.shape
    half = np.array([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    grey = photograph.pixels().astype(np.float32)
    image = cv2.warpAffine(grey, half, (2 * width, 2 * height), flags=flags, borderMode=cv2.BORDER_REFLECT)
    return _blurred(np.asarray(image, np.float32), math.sqrt(_BASE_SIGMA**2 - (2 * _CAMERA_SIGMA) ** 2))


def _halved(image: Float32Array) -> Float32Array:
    height, width = image.shape
    size = max(width // 2, 1), max(height // 2, 1)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.float32)


def _blurred(image: Float32Array, sigma: float) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)
