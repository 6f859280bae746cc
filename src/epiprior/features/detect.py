"""Step 1: local features of a photograph, and their descriptors at a fixed orientation (paper, section 4.1 and 4.2).

An image larger than `FeatureSettings.max_image_size` is worked on at that size; locations and scales always come back
in pixels of the image as given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError, ImageError, SettingsError
from epiprior.types import Features, Float32Array, FloatArray, IntArray

Image = str | Path | NDArray[np.uint8]

# The stubs of OpenCV lack the factories of detectors.
_detectors: Any = cv2
# Lowe's pyramid as OpenCV and VLFeat build it: sigma of its base, layers of an octave.
_BASE_SIGMA = 1.6
_LAYERS = 3
_MIN_IMAGE_SIDE = 16


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """How features are found and described.

    Parameters
    ----------
    detector : str
        ``sift`` (OpenCV), ``colmap-sift`` (VLFeat's, through pycolmap), or another detector of OpenCV whose keypoints
        are described by SIFT: ``orb``, ``mser``, ``gftt``, ``fast``.
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


@dataclass(frozen=True)
class Photograph:
    """An image as it is worked on: grey, no larger than asked for.

    Parameters
    ----------
    grey : ndarray, shape (h, w), uint8
        The working image.
    size : tuple of int
        Width and height of the image as given.

    Notes
    -----
    It remembers what `describe_at_orientation` made of it: image 1 is described alike under every roll hypothesis, and
    both images under every preset.
    """

    grey: NDArray[np.uint8]
    size: tuple[int, int]
    described: dict[bytes, Float32Array] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def factors(self) -> FloatArray:
        """Pixels as given per working pixel, along x and y."""
        height, width = self.grey.shape
        return np.array([self.size[0] / width, self.size[1] / height])

    @property
    def factor(self) -> float:
        """Geometric mean of `factors`: what scales lengths."""
        return float(np.sqrt(self.factors.prod()))

    def to_given(self, xy: FloatArray) -> FloatArray:
        """Map working pixels to pixels of the image as given; pixel centres are integers in both."""
        return (xy + 0.5) * self.factors - 0.5

    def to_working(self, xy: FloatArray) -> FloatArray:
        """Map pixels of the image as given to working pixels."""
        return (xy + 0.5) / self.factors - 0.5

    @property
    def working_map(self) -> FloatArray:
        """The same as a 3 x 3 affine map of homogeneous points."""
        scale = 1 / self.factors
        shift = 0.5 * scale - 0.5
        return np.array([[scale[0], 0.0, shift[0]], [0.0, scale[1], shift[1]], [0.0, 0.0, 1.0]])


View = Image | Photograph


def load_photograph(image: View, max_image_size: int = 1024) -> Photograph:
    """Read an image, or take an array, as grey values at working size.

    Parameters
    ----------
    image : str, Path, ndarray or Photograph
        A file that OpenCV reads, or uint8 of shape (H, W) or (H, W, 3) RGB. A photograph that was loaded at the same
        `max_image_size` comes back as it is.
    max_image_size : int
        Longer side of the working image, pixels.

    Raises
    ------
    ImageError
        If the file is missing or no image, the array has another shape or type or is empty, or the photograph was
        loaded at another size.
    """
    if isinstance(image, Photograph):
        if max(image.grey.shape) != min(max(image.size), max_image_size):
            raise ImageError(
                f"a photograph of {image.grey.shape[::-1]} was not loaded at max_image_size {max_image_size}"
            )
        return image
    grey = read_image(Path(image), cv2.IMREAD_GRAYSCALE) if isinstance(image, str | Path) else _grey_of_array(image)
    height, width = grey.shape
    size = working_size((width, height), max_image_size)
    if size != (width, height):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Photograph(np.ascontiguousarray(grey), (width, height))


def working_size(size: tuple[int, int], max_image_size: int = 1024) -> tuple[int, int]:
    """Return the size at which an image of a size (width, height) is worked on."""
    ratio = min(1.0, max_image_size / max(size))
    return max(1, round(size[0] * ratio)), max(1, round(size[1] * ratio))


def blank_photograph(size: tuple[int, int], max_image_size: int = 1024) -> Photograph:
    """Return a photograph of a size (width, height) without an image, for its change of coordinates."""
    width, height = working_size(size, max_image_size)
    return Photograph(np.broadcast_to(np.uint8(0), (height, width)), size)


def read_image(path: Path, flags: int) -> NDArray[np.uint8]:
    """Read an image as OpenCV does with `flags`; an `ImageError` names a file that is missing or no image."""
    try:
        if not path.is_file():
            raise ImageError(f"{path}: is a folder, not an image" if path.is_dir() else f"{path}: no such image file")
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        pixels = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ImageError(f"{path}: not an image that OpenCV can read")
    return np.asarray(pixels, dtype=np.uint8)


def _grey_of_array(image: Any) -> NDArray[np.uint8]:
    if not isinstance(image, np.ndarray):
        raise ImageError(f"an image is a path or a uint8 array, not {type(image).__name__}")
    if image.dtype != np.uint8:
        raise ImageError(f"the image array is {image.dtype}, expected uint8")
    if image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise ImageError(f"the image array has shape {image.shape}, expected (H, W) or (H, W, 3) RGB, not empty")
    if image.ndim == 3:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    return image


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
        In pixels of the image as given. Empty for an image without texture or smaller than 16 pixels.
    """
    settings = settings or FeatureSettings()
    if min(photograph.grey.shape) < _MIN_IMAGE_SIDE:
        return _as_features(photograph, np.empty((0, 4)), np.empty((0, 128), np.float32))
    frames, descriptors = DETECTORS[settings.detector](photograph.grey, settings.max_keypoints)
    return _as_features(photograph, frames, descriptors)


def _as_features(photograph: Photograph, frames: FloatArray, descriptors: Float32Array) -> Features:
    """Make Features of frames (x, y, sigma, orientation in degrees) in working pixels."""
    return Features(
        xy=photograph.to_given(frames[:, :2]),
        scale=frames[:, 2] * photograph.factor,
        orientation_deg=np.mod(frames[:, 3], 360.0),
        descriptors=descriptors,
        image_size=photograph.size,
    )


def _sift() -> Any:
    # Without the precise upscaling OpenCV's keypoints are biased by a quarter of a pixel.
    return _detectors.SIFT_create(enable_precise_upscale=True)


def _frames_of(keypoints: tuple[Any, ...]) -> FloatArray:
    frames = np.array([(*k.pt, k.size / 2, k.angle) for k in keypoints], dtype=np.float64)
    return frames.reshape(-1, 4)


def _detect_sift(grey: NDArray[np.uint8], limit: int) -> tuple[FloatArray, Float32Array]:
    sift = _detectors.SIFT_create(nfeatures=limit, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(grey, None)
    if not keypoints:
        return np.empty((0, 4)), np.empty((0, 128), np.float32)
    return _frames_of(keypoints), descriptors


def _detect_by(
    create: Callable[[int], Any],
) -> Callable[[NDArray[np.uint8], int], tuple[FloatArray, Float32Array]]:
    """Return a front end that finds keypoints with an OpenCV detector and describes them by SIFT."""

    def detect(grey: NDArray[np.uint8], limit: int) -> tuple[FloatArray, Float32Array]:
        keypoints = sorted(create(limit).detect(grey, None), key=lambda k: (-k.response, k.pt, k.size))[:limit]
        frames = _frames_of(tuple(keypoints))
        if not len(frames):
            return frames, np.empty((0, 128), np.float32)
        # The size of these keypoints is the diameter of a region; SIFT's window is six sigma to either side.
        frames[:, 2] = np.maximum(frames[:, 2] / 6.0, 0.8)
        frames[:, 3] = np.where(frames[:, 3] < 0, 0.0, frames[:, 3])
        return frames, describe_frames(grey, frames)

    return detect


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
    "orb": _detect_by(lambda limit: _detectors.ORB_create(nfeatures=limit)),
    "mser": _detect_by(lambda _: _detectors.MSER_create()),
    "gftt": _detect_by(lambda limit: _detectors.GFTTDetector_create(maxCorners=limit)),
    "fast": _detect_by(lambda _: _detectors.FastFeatureDetector_create()),
}


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
    kept, descriptors = _sift().compute(grey, keypoints)
    if descriptors is None or len(kept) != len(frames):
        raise FeatureError(f"SIFT described {len(kept)} of {len(frames)} features; are they inside the image?")
    return np.asarray(descriptors, dtype=np.float32)


def describe_at_orientation(photograph: Photograph, features: Features, orientation_deg: float) -> Float32Array:
    """Return descriptors with every feature's orientation fixed to one angle (section 4.2, generalised upright SIFT).

    Parameters
    ----------
    photograph : Photograph
        The image the features lie in.
    features : Features
        N features, pixels of the image as given.
    orientation_deg : float
        The orientation, degrees clockwise on the screen.

    Returns
    -------
    ndarray, shape (N, 128), float32
        Not normalised, and read-only: the photograph remembers it.
    """
    angle = np.full(len(features), orientation_deg)
    frames = np.column_stack([photograph.to_working(features.xy), features.scale / photograph.factor, angle])
    key = frames.tobytes()
    if key not in photograph.described:
        descriptors = describe_frames(photograph.grey, frames)
        descriptors.flags.writeable = False
        photograph.described[key] = descriptors
    return photograph.described[key]


def normalise_descriptors(descriptors: Float32Array, *, root: bool, centred: bool) -> Float32Array:
    """Return unit descriptors, whose inner product is the similarity (section 4.1).

    Parameters
    ----------
    descriptors : ndarray, shape (N, D), float32
        Descriptors; for `root`, non-negative ones.
    root : bool
        Take the square root of the L1-normalised descriptor first.
    centred : bool
        Subtract each descriptor's mean: normalised cross-correlation.

    Returns
    -------
    ndarray, shape (N, D), float32
        A descriptor without any contrast stays zero.
    """
    d = np.asarray(descriptors, dtype=np.float32)
    if root:
        total = np.abs(d).sum(axis=1, keepdims=True)
        d = np.sqrt(np.maximum(d, 0.0) / np.maximum(total, 1e-12))
    if centred and d.size:
        d = d - d.mean(axis=1, keepdims=True)
    norm = np.sqrt(np.einsum("ij,ij->i", d, d))[:, None]
    return np.ascontiguousarray(d / np.maximum(norm, 1e-12), dtype=np.float32)


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
