"""Raw material of textures: photographs that scikit-image and scikit-learn carry, and natural noise."""

import functools
from collections.abc import Sequence
from importlib import resources
from typing import Literal

import cv2
import numpy as np
from PIL import Image as PillowImage
from scipy import fft

from epiprior.types import Float32Array
from epiprior_lab.scenes.world import Image

Colour = tuple[float, float, float]
Grain = Literal["fine", "middle", "coarse"]

_PNG = ("astronaut", "brick", "camera", "chelsea", "coffee", "coins", "grass", "gravel", "moon")
_FILES = {name: ("skimage.data", f"{name}.png") for name in _PNG}
_FILES |= {"tissue": ("skimage.data", "ihc.png"), "motorcycle": ("skimage.data", "motorcycle_left.png")}
_FILES |= {"rocket": ("skimage.data", "rocket.jpg")}
_FILES |= {name: ("sklearn.datasets.images", f"{name}.jpg") for name in ("china", "flower")}
PICTURES = ("astronaut", "camera", "chelsea", "china", "coffee", "coins", "flower", "motorcycle", "rocket")
"""Photographs with things in them: for posters, signs and what stands behind a window."""
SURFACES = ("brick", "grass", "gravel", "tissue", "moon", "coffee", "china", "motorcycle")
"""Photographs whose detail serves as the unevenness of a surface."""

DUPLEX = cv2.FONT_HERSHEY_DUPLEX

_EXPONENT: dict[Grain, float] = {"fine": 0.5, "middle": 1.0, "coarse": 1.7}
_FIELD_SIDE = 2048


@functools.cache
def photograph(name: str) -> Image:
    """Return a packaged photograph, (H, W, 3), RGB, not to be written into."""
    package, file = _FILES[name]
    with resources.files(package).joinpath(file).open("rb") as stream, PillowImage.open(stream) as picture:
        image = np.array(picture.convert("RGB"))
    image.setflags(write=False)
    return image


@functools.cache
def _noise_field(grain: Grain) -> Float32Array:
    """Return a periodic random field, mean 0 and deviation 1; amplitude falls with a power of frequency."""
    rng = np.random.default_rng(list(_EXPONENT).index(grain))
    white = rng.standard_normal((_FIELD_SIDE, _FIELD_SIDE), dtype=np.float32)
    spectrum = fft.rfft2(white)
    frequency = np.hypot(fft.fftfreq(_FIELD_SIDE)[:, None], fft.rfftfreq(_FIELD_SIDE)[None]).astype(np.float32)
    frequency[0, 0] = np.inf
    field = fft.irfft2(spectrum * np.maximum(frequency, 2.0 / _FIELD_SIDE) ** -_EXPONENT[grain])
    return np.ascontiguousarray((field / field.std()).astype(np.float32))


def noise(rng: np.random.Generator, height: int, width: int, grain: Grain) -> Float32Array:
    """Return a random window (height, width) of a noise field of mean 0 and deviation 1; maybe mirrored."""
    top, left = rng.integers(_FIELD_SIDE, size=2)
    rows, columns = np.arange(top, top + height), np.arange(left, left + width)
    window = _noise_field(grain).take(rows, axis=0, mode="wrap").take(columns, axis=1, mode="wrap")
    return window[:: rng.choice((-1, 1)), :: rng.choice((-1, 1))]


def crop(
    rng: np.random.Generator, height: int, width: int, names: Sequence[str], *, part: tuple[float, float] = (0.3, 1.0)
) -> Image:
    """Return a random crop of one of the photographs `names`, (height, width, 3).

    `part` bounds the side of the crop as a part of the largest crop of that shape.
    """
    image = photograph(names[int(rng.integers(len(names)))])
    rows, columns = image.shape[:2]
    scale = min(rows / height, columns / width) * rng.uniform(*part)
    h, w = max(2, int(height * scale)), max(2, int(width * scale))
    top, left = int(rng.integers(rows - h + 1)), int(rng.integers(columns - w + 1))
    window = image[top : top + h, left : left + w, :]
    if rng.random() < 0.5:
        window = window[:, ::-1]
    how = cv2.INTER_AREA if h > height else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(np.ascontiguousarray(window), (width, height), interpolation=how), dtype=np.uint8)


def letters(rng: np.random.Generator, count: int) -> str:
    """Return random capital letters and blanks."""
    return "".join(chr(c) if c < 91 else " " for c in rng.integers(65, 95, size=count).tolist())


def surface(rng: np.random.Generator, height: int, width: int, names: Sequence[str], *, zoom: float) -> Float32Array:
    """Return a photograph's brightness, mirrored in tiles, mean 0, deviation 1; `zoom` texels per pixel."""
    image = cv2.cvtColor(photograph(names[int(rng.integers(len(names)))]), cv2.COLOR_RGB2GRAY)
    rows, columns = int(np.ceil(height / zoom)) + 1, int(np.ceil(width / zoom)) + 1
    top, left = int(rng.integers(image.shape[0])), int(rng.integers(image.shape[1]))
    mirrored = np.pad(image, ((0, rows), (0, columns)), mode="symmetric")
    window = mirrored[top : top + rows, left : left + columns].astype(np.float32)
    window = cv2.resize(window, None, fx=zoom, fy=zoom)[:height, :width]
    window = cv2.resize(window, (width, height)) if window.shape != (height, width) else window
    return np.asarray((window - window.mean()) / max(float(window.std()), 1.0), dtype=np.float32)


def tinted(
    base: Colour, relief: Float32Array, second: Colour | None = None, mixture: Float32Array | None = None
) -> Image:
    """Return an RGB image of one colour times ``1 + relief``; `mixture` in [0, 1] leads to a second colour."""
    factor = 1.0 + relief
    colours: Sequence[Float32Array | float] = base
    if second is not None and mixture is not None:
        colours = [one + (other - one) * mixture for one, other in zip(base, second, strict=True)]
    channels = [cv2.convertScaleAbs(np.maximum(factor * colour, 0.0)) for colour in colours]
    return np.asarray(cv2.merge(channels), dtype=np.uint8)
