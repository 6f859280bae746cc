"""Images as they are worked on: any file that OpenCV decodes, or an array, as grey values at working size.

An image larger than `FeatureSettings.max_image_size` is worked on at that size; locations and scales always come back
in pixels of the image as given. docs/images.md says what forms of images are read and how.
"""

import contextlib
import functools
import logging
import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import ImageError
from epiprior.types import BoolArray, Float32Array, FloatArray

Image = str | Path | NDArray[np.uint8]

_logger = logging.getLogger(__name__)
_stderr_lock = threading.Lock()
_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
# What OpenCV allows unless an environment variable of the name after OPENCV_IO_MAX_IMAGE_ says otherwise.
_LIMITS = {"PIXELS": 1 << 30, "WIDTH": 1 << 20, "HEIGHT": 1 << 20}


@dataclass(frozen=True)
class Photograph:
    """An image as it is worked on: grey, no larger than asked for.

    It keeps what `describe_at_orientation` computed for it: image 1 is described alike under every roll hypothesis, and
    both images under every preset. The scale space that this takes, 64 bytes a pixel, stays as well.
    """

    grey: NDArray[np.uint8]  # (h, w), the working image
    size: tuple[int, int]  # width and height of the image as given
    visible: BoolArray | None = None  # (h, w), where the image is not transparent; None: everywhere
    name: str = ""  # of the file, for messages; empty for an array
    decode: Callable[[], NDArray[np.uint8]] | None = field(default=None, repr=False, compare=False)  # if not `grey`
    described: dict[bytes, Float32Array] = field(default_factory=dict, init=False, repr=False, compare=False)
    octaves: dict[int, list[Float32Array]] = field(default_factory=dict, init=False, repr=False, compare=False)

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

    def pixels(self) -> NDArray[np.uint8]:
        """Return `grey`; one that is kept without its pixels decodes them."""
        return self.decode() if self.decode else self.grey

    def shows(self, xy: FloatArray) -> BoolArray:
        """Return at which working pixels, shape (N, 2), the image is not transparent."""
        if self.visible is None:
            return np.ones(len(xy), np.bool_)
        column, row = np.clip(np.rint(xy).astype(int), 0, np.array(self.grey.shape[::-1]) - 1).T
        return np.asarray(self.visible[row, column])


View = Image | Photograph


def load_photograph(
    image: View, max_image_size: int = 1024, *, turn: bool = True, mask: BoolArray | None = None
) -> Photograph:
    """Read an image, or take a uint8 array (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, as grey values at working size.

    A file is turned by its EXIF orientation unless `turn` is False. Where `mask`, (H, W), is False, all is transparent.
    A photograph that was loaded at the same `max_image_size` (longer side, pixels) comes back as it is. ImageError if
    it was loaded at another size, the file is missing or no image, or the array is of another kind or empty.
    """
    if isinstance(image, Photograph):
        if max(image.grey.shape) != min(max(image.size), max_image_size):
            raise ImageError(
                f"a photograph of {image.grey.shape[::-1]} was not loaded at max_image_size {max_image_size}"
            )
        return image
    if isinstance(image, str | Path):
        name = str(image)
        data = _read_bytes(Path(image))
        grey = _decode(name, data, cv2.IMREAD_GRAYSCALE | (0 if turn else cv2.IMREAD_IGNORE_ORIENTATION))
        visible = _visible_in_file(name, data, grey)
    else:
        name = ""
        grey, visible = _grey_of_array(image)
    if mask is not None:
        if mask.shape != grey.shape:
            raise ImageError(f"{name or 'the image'}: is {grey.shape[::-1]}, its mask {mask.shape[::-1]}")
        visible = mask if visible is None else visible & mask
    if visible is not None:
        # No texture where there is nothing to see, which would use up the number of features.
        grey = np.where(visible, grey, np.uint8(grey[visible].mean() if visible.any() else 0))
    height, width = grey.shape
    size = working_size((width, height), max_image_size)
    if size != (width, height):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if visible is not None:
            visible = cv2.resize(visible.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) == 255
    return Photograph(np.ascontiguousarray(grey), (width, height), visible, name)


def working_size(size: tuple[int, int], max_image_size: int = 1024) -> tuple[int, int]:
    """Return the size at which an image of a size (width, height) is worked on."""
    ratio = min(1.0, max_image_size / max(size))
    return max(1, round(size[0] * ratio)), max(1, round(size[1] * ratio))


def blank_photograph(size: tuple[int, int], max_image_size: int = 1024) -> Photograph:
    """Return a photograph of a size (width, height) without an image, for its change of coordinates."""
    width, height = working_size(size, max_image_size)
    return Photograph(np.broadcast_to(np.uint8(0), (height, width)), size)


def is_hidden_copy(name: str) -> bool:
    """Return whether a file of that name is what macOS leaves beside a file, such as ``._x.jpg``: never an image."""
    return name.startswith("._")


def read_image(path: str | Path, flags: int) -> NDArray[np.uint8]:
    """Read an image file as OpenCV does with `flags`, eight bits; ImageError names a file that cannot be read.

    More than eight bits are stretched: the darkest value of the image becomes 0, its brightest 255. A JPEG file that is
    damaged or cut is read as far as it goes, and a warning names it.
    """
    return _decode(str(path), _read_bytes(Path(path)), flags)


def _read_bytes(path: Path) -> NDArray[np.uint8]:
    try:
        if not path.is_file():
            raise ImageError(f"{path}: is a folder, not an image" if path.is_dir() else f"{path}: no such image file")
        data = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}") from error
    # Without an end OpenCV gives nothing at all of a JPEG file that was cut; one too many does no harm.
    return np.frombuffer(data + _JPEG_END if data.startswith(_JPEG_START) else data, dtype=np.uint8)


def _decode(name: str, data: NDArray[np.uint8], flags: int) -> NDArray[np.uint8]:
    damage: list[str] = []
    try:
        with _overhear(damage) if _is_jpeg(data) else contextlib.nullcontext():
            pixels = cv2.imdecode(data, flags | cv2.IMREAD_ANYDEPTH) if data.size else None
    except cv2.error as error:
        pixels = None
        if limit := re.search(r"CV_IO_MAX_IMAGE_(PIXELS|WIDTH|HEIGHT)", str(error)):
            variable = f"OPENCV_IO_MAX_IMAGE_{limit[1]}"
            allowed = os.environ.get(variable) or _LIMITS[limit[1]]
            raise ImageError(
                f"{name}: OpenCV reads at most {allowed} {limit[1].lower()}; to raise this limit, set the environment "
                f"variable {variable} before the start"
            ) from error
    if pixels is None:
        raise ImageError(f"{name}: not an image that OpenCV can read")
    if damage:
        _warn_once(f"{name}: damaged or cut, parts of the image are wrong or missing ({'; '.join(damage)})")
    if pixels.dtype != np.uint8:
        pixels = cv2.normalize(pixels, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    return np.asarray(pixels, dtype=np.uint8)


def _is_jpeg(data: NDArray[np.uint8]) -> bool:
    return data[:2].tobytes() == _JPEG_START


@contextlib.contextmanager
def _overhear(lines: list[str]) -> Iterator[None]:
    """Collect what libjpeg says of damage, on stderr and without naming the file; all else passes on to stderr."""
    with _stderr_lock, tempfile.TemporaryFile() as said:
        try:
            stderr = os.dup(2)
        except OSError:  # there is none, and nothing to hear
            yield
            return
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            said.seek(0)
            for line in said:
                if b"JPEG" in line:
                    lines.append(line.decode(errors="replace").strip())
                else:
                    os.write(2, line)


@functools.cache
def _warn_once(text: str) -> None:
    _logger.warning(text)


def _visible_in_file(name: str, data: NDArray[np.uint8], grey: NDArray[np.uint8]) -> BoolArray | None:
    """Return where an image is not wholly transparent; None: everywhere."""
    stored = None if _is_jpeg(data) else cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if stored is None or stored.shape[2:] != (4,) or stored[..., 3].all():
        return None
    # The alpha channel comes as it is stored, the image turned by its EXIF orientation: one of eight ways.
    upright = _decode(name, data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    visible = np.asarray(stored[..., 3] > 0)
    for turns in range(8):
        flip = slice(None, None, 1 if turns < 4 else -1)
        if np.array_equal(np.rot90(upright[:, flip], turns), grey):
            return np.rot90(visible[:, flip], turns)
    return None


def check_pixels(image: Any) -> None:
    """Raise ImageError unless `image` is uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, not empty."""
    if not isinstance(image, np.ndarray):
        raise ImageError(f"an image is a path or a uint8 array, not {type(image).__name__}")
    if image.dtype != np.uint8:
        raise ImageError(f"the image array is {image.dtype}, expected uint8")
    if image.size == 0 or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,), (4,)):
        raise ImageError(
            f"the image array has shape {image.shape}, expected (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, not empty"
        )


def _grey_of_array(image: Any) -> tuple[NDArray[np.uint8], BoolArray | None]:
    check_pixels(image)
    visible = image[..., 3] > 0 if image.shape[2:] == (4,) else None
    if image.ndim == 3:
        image = np.asarray(cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    return image, visible
