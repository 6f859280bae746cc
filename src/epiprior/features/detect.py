"""Step 1: local features of a photograph (paper, section 4.1)."""

from typing import Any

import cv2
import numpy as np

from epiprior.errors import FeatureError, require
from epiprior.features.describe import describe_frames
from epiprior.features.images import Photograph, View, load_photograph
from epiprior.presets import FeatureSettings
from epiprior.types import Features, Float32Array, FloatArray

_MIN_IMAGE_SIDE = 16
_FEW = 100


def detect_features(photograph: Photograph, settings: FeatureSettings | None = None) -> Features:
    """Find features and describe them at their own orientation; locations in pixels of the image as given.

    There are none where the image is transparent, without texture, or smaller than 16 pixels.
    """
    settings = settings or FeatureSettings()
    frames, descriptors = np.empty((0, 4)), np.empty((0, 128), np.float32)
    if min(photograph.grey.shape) >= _MIN_IMAGE_SIDE:
        detect = _sift if settings.detector == "sift" else _colmap_sift
        frames, descriptors = detect(photograph, settings)
        shown = photograph.shows(frames[:, :2])
        frames, descriptors = frames[shown], descriptors[shown]
    return Features(
        xy=photograph.to_given(frames[:, :2]),
        scale=frames[:, 2] * photograph.factor,
        orientation_deg=np.mod(frames[:, 3], 360.0),
        descriptors=descriptors,
        image_size=photograph.size,
    )


# Detectors return frames (x, y, sigma, orientation in degrees), shape (N, 4), working pixels, and (N, 128) descriptors.


def _sift(photograph: Photograph, settings: FeatureSettings) -> tuple[FloatArray, Float32Array]:
    opencv: Any = cv2  # its stubs lack the factories of detectors
    detector = opencv.SIFT_create(
        # The strongest are kept of those that are large enough.
        nfeatures=0 if settings.min_scale else settings.max_keypoints,
        contrastThreshold=settings.contrast_threshold,
        # Without the precise upscaling OpenCV's keypoints are biased by a quarter of a pixel.
        enable_precise_upscale=True,
    )
    keypoints = detector.detect(photograph.grey)
    frames = np.array([(*k.pt, k.size / 2, k.angle) for k in keypoints], dtype=np.float64).reshape(-1, 4)
    if settings.min_scale:
        large = np.flatnonzero(frames[:, 2] >= settings.min_scale)
        response = np.array([k.response for k in keypoints])
        frames = frames[large[np.argsort(-response[large], kind="stable")[: settings.max_keypoints]]]
    return frames, describe_frames(photograph, frames)


def _colmap_sift(photograph: Photograph, settings: FeatureSettings) -> tuple[FloatArray, Float32Array]:
    pycolmap = require("pycolmap", "the detector colmap-sift", FeatureError)
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = settings.max_keypoints
    options.sift.peak_threshold = max(settings.contrast_threshold / 3.0, 1e-9)  # it must be positive
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, found = extractor.extract(pycolmap.Bitmap.from_array(photograph.grey))
    frames = np.asarray(pycolmap.keypoints_to_matrix(keypoints), dtype=np.float64).reshape(-1, 4)
    # COLMAP's origin is the corner of the top-left pixel; its descriptors are square roots of L1-normalised ones.
    frames[:, :2] -= 0.5
    frames[:, 3] = np.rad2deg(frames[:, 3])
    return frames, np.square(np.asarray(found.data, dtype=np.float32).reshape(-1, 128))


def explain_shortage(
    images: tuple[View | None, View | None],
    features: tuple[Features | None, Features | None],
    settings: FeatureSettings,
) -> str:
    """Return which of the images have few features, and what may explain it; an empty string where neither has.

    Images and features as handed in; where features are None, they are found again by `settings`.
    """
    reasons = []
    for k, (image, given) in enumerate(zip(images, features, strict=True), start=1):
        photograph = None if image is None else load_photograph(image, settings.max_image_size)
        found = detect_features(photograph, settings) if given is None and photograph is not None else given
        if found is None or len(found) >= _FEW:
            continue
        name = (photograph and photograph.name) or f"image {k}"
        count = f"{name}: {len(found)} features"
        reasons.append(count if photograph is None else f"{count} {_what_may_explain_few(photograph)}")
    return "; ".join(reasons)


def _what_may_explain_few(photograph: Photograph) -> str:
    """Return the grey values, the working size, and what to set."""
    height, width = photograph.grey.shape
    grey = photograph.pixels()
    darkest, brightest = int(grey.min()), int(grey.max())
    facts = f"(darkest {darkest}, brightest {brightest}; worked at {width} x {height})"
    if darkest == brightest:
        return f"{facts}: the image is blank"
    if (width, height) != photograph.size:
        return f"{facts}: set --max-image-size higher, the image is {photograph.size[0]} x {photograph.size[1]}"
    return facts
