"""Photographs that scikit-image and scikit-learn carry, natural noise, and textures: walls, roofs, floors, foliage."""

import functools
from collections.abc import Sequence
from importlib import resources
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np
from numpy.random import Generator
from PIL import Image as PillowImage
from scipy import fft

from epiprior.types import Float32Array
from epiprior_lab.scenes.world import Colour, Image, Span

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

_EXPONENT: dict[Grain, float] = {"fine": 0.5, "middle": 1.0, "coarse": 1.7}
_FIELD_SIDE = 2048

MASONRY = ("brick", "ashlar", "plaster", "tiles", "planks", "rubble")

WALL_COLOURS: tuple[Colour, ...] = (
    (190, 176, 152), (156, 96, 76), (140, 82, 66), (182, 182, 176), (206, 194, 158), (190, 152, 130),
    (220, 216, 206), (146, 138, 122), (164, 152, 132), (120, 124, 128), (182, 160, 130), (126, 102, 86),
    (178, 186, 180), (204, 188, 172),
)  # fmt: skip
ROOF_COLOURS: tuple[Colour, ...] = ((138, 70, 52), (92, 90, 94), (116, 64, 52), (74, 78, 88), (150, 96, 72))

# Heights and widths of stones in metres, how much their tones differ, and how dark their joints are.
_COURSES: dict[str, tuple[tuple[float, float], tuple[float, float], float, float]] = {
    "brick": ((0.075, 0.11), (0.22, 0.34), 0.06, 0.10),
    "ashlar": ((0.32, 0.6), (0.5, 1.1), 0.035, 0.16),
    "tiles": ((0.25, 0.6), (0.25, 0.6), 0.03, 0.14),
    "planks": ((0.12, 0.22), (1.5, 4.0), 0.06, 0.22),
    "rubble": ((0.18, 0.3), (0.25, 0.6), 0.10, 0.20),
}


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


def noise(rng: Generator, height: int, width: int, grain: Grain) -> Float32Array:
    """Return a random window (height, width) of a noise field of mean 0 and deviation 1; maybe mirrored."""
    top, left = rng.integers(_FIELD_SIDE, size=2)
    rows, columns = np.arange(top, top + height), np.arange(left, left + width)
    window = _noise_field(grain).take(rows, axis=0, mode="wrap").take(columns, axis=1, mode="wrap")
    return window[:: rng.choice((-1, 1)), :: rng.choice((-1, 1))]


def crop(rng: Generator, height: int, width: int, names: Sequence[str] = PICTURES, *, part: Span = (0.3, 1.0)) -> Image:
    """Return a random crop (height, width, 3) of one of the photographs `names`, its side a `part` of the largest."""
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


def letters(rng: Generator, count: int) -> str:
    """Return random capital letters and blanks."""
    return "".join(chr(c) if c < 91 else " " for c in rng.integers(65, 95, size=count).tolist())


def surface(rng: Generator, height: int, width: int, names: Sequence[str] = SURFACES, *, zoom: float) -> Float32Array:
    """Return a photograph's brightness, mirrored in tiles, mean 0, deviation 1; `zoom` texels per pixel."""
    image = cv2.cvtColor(photograph(names[int(rng.integers(len(names)))]), cv2.COLOR_RGB2GRAY)
    rows, columns = int(np.ceil(height / zoom)) + 1, int(np.ceil(width / zoom)) + 1
    top, left = int(rng.integers(image.shape[0])), int(rng.integers(image.shape[1]))
    mirrored = np.pad(image, ((0, rows), (0, columns)), mode="symmetric")[top : top + rows, left : left + columns]
    window = cv2.resize(mirrored.astype(np.float32), None, fx=zoom, fy=zoom)[:height, :width]
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


def jittered(rng: Generator, colour: Colour, by: float) -> Colour:
    """Return a colour near another: brightness and each channel changed by up to the part `by`."""
    factor = 1.0 + rng.uniform(-by, by)
    r, g, b = (float(np.clip(c * factor * (1 + rng.uniform(-by, by) / 6), 8, 245)) for c in colour)
    return r, g, b


class WallStyle:
    """What a wall is made of; the more `distinct` (0 to 1), the more stains and unevenness tell one place from another.

    The second colour shows in stains; `course_m` and `stone_m` are height and width of a stone, metres; `roughness` and
    `stains` are deviations of brightness by unevenness and over metres, as parts of brightness.
    """

    def __init__(self, rng: Generator, *, distinct: float) -> None:
        self.masonry = MASONRY[int(rng.choice(len(MASONRY), p=[0.24, 0.22, 0.26, 0.08, 0.06, 0.14]))]
        course, stone, *_ = _COURSES.get(self.masonry, ((1.0, 1.0), (1.0, 1.0)))
        self.colour = jittered(rng, WALL_COLOURS[int(rng.integers(len(WALL_COLOURS)))], 0.12)
        self.second_colour = jittered(rng, self.colour, 0.3)
        self.course_m, self.stone_m = rng.uniform(*course), rng.uniform(*stone)
        self.roughness = float(rng.uniform(0.015, 0.035) + 0.05 * distinct * rng.uniform(0.4, 1.0))
        self.stains = float(rng.uniform(0.02, 0.05) + 0.09 * distinct * rng.uniform(0.4, 1.0))


def courses(
    rng: Generator, height: int, width: int, stone: Span, *, tones: float, joints: float, regular: bool = True
) -> Float32Array:
    """Return rows of stones, `stone` pixels high and wide, as deviations from brightness 1; in bond when `regular`."""
    course_px, stone_px = stone
    relief = np.empty((height, width), dtype=np.float32)
    edges = np.unique(np.rint(np.arange(0.0, height + course_px, course_px)).astype(int))
    joint = max(1, round(0.07 * course_px))
    columns = np.arange(width)
    count = int(width / stone_px) + 4
    for row, (top, bottom) in enumerate(pairwise(edges.tolist())):
        widths = np.full(count, stone_px) if regular else stone_px * rng.uniform(0.5, 1.5, size=2 * count)
        shift = (0.5 * (row % 2) if regular else rng.random()) * stone_px
        borders = np.cumsum(widths) - shift
        line = rng.normal(0.0, tones, size=len(widths) + 1).astype(np.float32)
        line = line[np.searchsorted(borders, columns, side="right")]
        relief[top:bottom] = line
        starts = borders[borders < width].astype(int)
        for offset in range(joint):
            relief[top:bottom, np.clip(starts + offset, 0, width - 1)] = -joints
        relief[top : top + joint] = -joints
        relief[min(top + joint, height - 1)] += 0.3 * joints
    return relief


def wall(rng: Generator, height: int, width: int, style: WallStyle, *, texels_per_m: float) -> Image:
    """Return a wall, shape (height, width, 3), that repeats only what its masonry repeats."""
    grain = ("gravel", "grass", "tissue", "moon")
    relief = style.roughness * surface(rng, height, width, grain, zoom=rng.uniform(0.8, 2.5))
    relief += 0.7 * style.roughness * noise(rng, height, width, "fine")
    stains = noise(rng, height, width, "coarse")
    relief += style.stains * stains + 0.5 * style.stains * noise(rng, height, width, "middle")
    if style.masonry in _COURSES:
        *_, tones, joints = _COURSES[style.masonry]
        stone = max(3.0, style.course_m * texels_per_m), max(5.0, style.stone_m * texels_per_m)
        regular = style.masonry in ("brick", "tiles", "ashlar")
        relief += courses(rng, height, width, stone, tones=tones, joints=joints, regular=regular)
    elif rng.random() < 0.7:
        for _ in range(int(rng.integers(3, 12))):
            _add_crack(rng, relief)
    mixture = np.clip(0.5 + 0.35 * stains, 0.0, 1.0)
    return tinted(style.colour, relief, style.second_colour, mixture)


def _add_crack(rng: Generator, relief: Float32Array) -> None:
    steps = int(rng.integers(10, 60))
    angle = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.45, size=steps))
    path = np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(3, 9), axis=0)
    path += rng.uniform((0, 0), relief.shape[::-1])
    cv2.polylines(relief, [path.astype(np.int32)], False, -rng.uniform(0.15, 0.4), int(rng.integers(1, 3)))


def roof(rng: Generator, height: int, width: int, *, texels_per_m: float) -> Image:
    """Return rows of roof tiles."""
    colour = jittered(rng, ROOF_COLOURS[int(rng.integers(len(ROOF_COLOURS)))], 0.15)
    course, stone = rng.uniform(0.2, 0.35) * texels_per_m, rng.uniform(0.2, 0.35) * texels_per_m
    relief = courses(rng, height, width, (course, stone), tones=0.08, joints=0.25)
    relief += 0.08 * noise(rng, height, width, "middle") + 0.04 * noise(rng, height, width, "fine")
    return tinted(colour, relief, (90, 96, 70), np.clip(0.25 * noise(rng, height, width, "coarse"), 0, 1))


def pavement(rng: Generator, height: int, width: int, *, texels_per_m: float) -> Image:
    """Return a floor: slabs, setts, asphalt, gravel or grass."""
    kind = rng.choice(("slabs", "setts", "asphalt", "gravel", "grass"))
    relief = 0.07 * noise(rng, height, width, "coarse") + 0.03 * noise(rng, height, width, "fine")
    if kind == "grass":
        relief += 0.16 * surface(rng, height, width, ("grass",), zoom=rng.uniform(0.4, 0.8))
        mixture = np.clip(0.4 + 0.4 * noise(rng, height, width, "middle"), 0, 1)
        return tinted((104, 118, 62), relief, (150, 140, 84), mixture)
    grey = jittered(rng, (140, 134, 126), 0.2)
    if kind in ("slabs", "setts"):
        side = (rng.uniform(0.35, 0.8) if kind == "slabs" else rng.uniform(0.12, 0.2)) * texels_per_m
        stone, regular = side * rng.uniform(1.0, 1.6), rng.random() < 0.6
        relief += courses(rng, height, width, (side, stone), tones=0.08, joints=0.3, regular=regular)
    zoom = float(rng.uniform(0.2, 0.35) if kind == "asphalt" else rng.uniform(0.3, 0.6))
    relief += (0.12 if kind == "gravel" else 0.04) * surface(rng, height, width, ("gravel",), zoom=zoom)
    return tinted(grey, relief)


def foliage(rng: Generator, side: int) -> Image:
    """Return leaves with holes between them, shape (side, side, 4)."""
    relief = 0.35 * surface(rng, side, side, ("grass", "gravel"), zoom=rng.uniform(0.5, 1.0))
    relief += 0.25 * noise(rng, side, side, "middle")
    image = tinted(jittered(rng, (84, 104, 52), 0.25), relief)
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    density = 1.1 - np.hypot(x, y) * 1.35 + 0.35 * noise(rng, side, side, "middle")
    density += 0.25 * noise(rng, side, side, "fine")
    return np.dstack([image, np.where(density > 0, 255, 0).astype(np.uint8)])


def ornament(rng: Generator, height: int, width: int, colour: Colour) -> Image:
    """Return a carved relief in one colour, shape (height, width, 3): a part of a photograph turned to stone."""
    names = ("coins", "china", "flower", "motorcycle", "astronaut", "moon", "camera")
    carved = crop(rng, height, width, names, part=(0.2, 0.5))
    grey = cv2.cvtColor(carved, cv2.COLOR_RGB2GRAY).astype(np.float32)
    grey -= grey.mean()
    return tinted(colour, np.asarray(0.28 * grey / max(float(grey.std()), 4.0), dtype=np.float32))
