"""A world of textured flat faces, in metres: x right, y down, z away from a viewer before a facade; ground at y = 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.types import FloatArray, IntArray

Image = NDArray[np.uint8]
Vector = FloatArray | tuple[float, float, float] | list[float]
Colour = tuple[float, float, float]
Span = tuple[float, float]
Part = tuple[float, float, float, float]  # of a texture: left, top, right, bottom

BOTH_VIEWS, FIRST_VIEW, SECOND_VIEW = 3, 1, 2
MAX_LEVELS = 12
WHOLE = (0.0, 0.0, 1.0, 1.0)
_MIN_LEVEL_SIDE = 2


class World(NamedTuple):
    """N faces and T textures in flat arrays, ready to be drawn.

    `corner`, `across`, `down` (N, 3) are a corner of each face and its two edges from there; `texture_frame` (N, 3, 2)
    the texture coordinates (fractions of width and height) of the corner and their change along both edges. `texture`
    (N,) is the texture's number; `triangle` and `cut_out` are 1 for a triangle, and where transparent texels are holes;
    `views` is the bit set of the views that show the face. `brightness` (N,) is a factor on top of the light, `mirror`
    (N,) how much of the surroundings a glass texel reflects. `levels` (T, MAX_LEVELS, 3) holds first texel, width and
    height of each texture at each halving of its size; `texels` (M, 4) are red, green, blue, opacity (below 128: hole;
    128 to 255: glass to solid). `surroundings` (H, W, 3) are infinitely far, by elevation (zenith first) and azimuth.
    """

    corner: FloatArray
    across: FloatArray
    down: FloatArray
    texture_frame: FloatArray
    texture: IntArray
    triangle: IntArray
    cut_out: IntArray
    views: IntArray
    brightness: FloatArray
    mirror: FloatArray
    levels: IntArray
    texels: Image
    surroundings: Image


class WorldBuilder:
    """Collects faces and textures; `surroundings` as in `World`; `views` are those that show what is added."""

    def __init__(self, *, surroundings: Image) -> None:
        self.views = BOTH_VIEWS
        self._surroundings = surroundings
        self._faces: list[tuple[Any, ...]] = []  # in the order of the fields of `World`
        self._textures: list[Image] = []

    def texture(self, image: Image) -> int:
        """Add an image, shape (H, W, 3) or (H, W, 4), and return its number."""
        self._textures.append(image)
        return len(self._textures) - 1

    def face(
        self,
        corner: Vector,
        across: Vector,
        down: Vector,
        texture: int,
        *,
        area: Part = WHOLE,
        texture_frame: FloatArray | None = None,
        triangle: bool = False,
        mirror: float = 0.0,
        brightness: float = 1.0,
    ) -> None:
        """Add a parallelogram, or of a triangle the half beside the corner; see `World`.

        `corner` is the top left one as seen from the front; the edges go right and down. `area` is the part of the
        texture, fractions, which repeats beyond [0, 1]; or `texture_frame` (3, 2) is given.
        """
        left, top, right, bottom = area
        if texture_frame is None:
            texture_frame = np.array([[left, top], [right - left, 0.0], [0.0, bottom - top]])
        vectors = (np.asarray(vector, dtype=np.float64) for vector in (corner, across, down))
        flags = (texture, int(triangle), int(self._textures[texture].shape[2] == 4), self.views)
        self._faces.append((*vectors, texture_frame, *flags, brightness, mirror))

    def build(self) -> World:
        """Return the world; textures are packed with their halved copies, so that far faces do not alias."""
        columns: list[Any] = [np.array(column) for column in zip(*self._faces, strict=True)]
        levels = np.zeros((len(self._textures), MAX_LEVELS, 3), dtype=np.int64)
        texels: list[Image] = []
        used = 0
        for number, image in enumerate(self._textures):
            for level, halved in enumerate(_halvings(image)):
                height, width = halved.shape[:2]
                levels[number, level] = used, width, height
                texels.append(halved.reshape(-1, 4))
                used += height * width
            levels[number, level + 1 :] = levels[number, level]
        columns += [levels, np.concatenate(texels), self._surroundings]
        return World(*columns)


def _halvings(image: Image) -> list[Image]:
    """Return an image with opacity, and its copies at 1/2, 1/4, ... of the size."""
    if image.shape[2] == 3:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2RGBA), dtype=np.uint8)
    images = [np.ascontiguousarray(image)]
    while len(images) < MAX_LEVELS and min(images[-1].shape[:2]) >= 2 * _MIN_LEVEL_SIDE:
        height, width = images[-1].shape[:2]
        half = cv2.resize(images[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        images.append(np.asarray(half, dtype=np.uint8))
    return images


@dataclass(frozen=True)
class Frame:
    """A place to build at: `a` metres along a wall, `b` up from its foot, `c` out of it towards the viewer.

    `foot` is the left end of the foot, seen from the front; `right` and `outward` are horizontal unit vectors.
    """

    foot: FloatArray
    right: FloatArray
    outward: FloatArray

    @classmethod
    def facing(cls, foot: Vector, azimuth_deg: float) -> Frame:
        """Return the frame of a wall that faces the viewer (-z) at azimuth 0, and is turned with more."""
        angle = np.deg2rad(azimuth_deg)
        right = np.array([np.cos(angle), 0.0, np.sin(angle)])
        return cls(np.asarray(foot, dtype=np.float64), right, np.array([np.sin(angle), 0.0, -np.cos(angle)]))

    def point(self, a: float, b: float, c: float = 0.0) -> FloatArray:
        """Return the world position of (a, b, c)."""
        return np.asarray(self.foot + a * self.right + c * self.outward - np.array([0.0, b, 0.0]))

    def side(self, a: float, c: float = 0.0) -> Frame:
        """Return the frame of the wall that goes back from (a, 0, c): the right side of a house."""
        return Frame(self.point(a, 0.0, c), -self.outward, self.right)

    def left_side(self, c: float, a: float = 0.0) -> Frame:
        """Return the frame of the wall that comes forward from (a, 0, c): the left side of a house."""
        return Frame(self.point(a, 0.0, c), self.outward, -self.right)


def upright(
    world: WorldBuilder, frame: Frame, a: Span, b: Span, c: float, texture: int, area: Part = WHOLE, mirror: float = 0.0
) -> None:
    """Add an upright rectangle that faces the viewer of `frame`: a[0] to a[1], b[0] up to b[1], at c."""
    across, down = frame.right * (a[1] - a[0]), np.array([0.0, b[1] - b[0], 0.0])
    world.face(frame.point(a[0], b[1], c), across, down, texture, area=area, mirror=mirror)


def box(
    world: WorldBuilder, frame: Frame, a: Span, b: Span, c: Span, *, textures: int | Sequence[int], area: Part = WHOLE
) -> None:
    """Add a box; `textures` are of front and back, of the sides, and of top and bottom, or one of all."""
    front, sides, top = (textures,) * 3 if isinstance(textures, int) else textures
    upright(world, frame, a, b, c[1], texture=front, area=area)
    back = Frame(frame.point(a[1], 0.0, c[0]), -frame.right, -frame.outward)
    upright(world, back, (0.0, a[1] - a[0]), b, 0.0, texture=front, area=area)
    depth = c[1] - c[0]
    for side in (frame.side(a[1], c[1]), frame.left_side(c[0], a[0])):
        upright(world, side, (0.0, depth), b, 0.0, texture=sides, area=area)
    across, inward = frame.right * (a[1] - a[0]), frame.outward * depth
    world.face(frame.point(a[0], b[1], c[0]), across, inward, top, area=area)
    world.face(frame.point(a[0], b[0], c[1]), across, -inward, top, area=area, brightness=0.7)
