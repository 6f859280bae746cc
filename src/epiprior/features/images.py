"""Photographs as the method works on them: grey, and no larger than `FeatureSettings.max_image_size`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import ImageError
from epiprior.types import Float32Array, FloatArray

Image = str | Path | NDArray[np.uint8]


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
