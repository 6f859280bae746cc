"""Streets and open places: sky, ground and rim, what is built there and what stands about."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.random import Generator

from epiprior_lab.scenes.clutter import FURNITURE, PASSING, add_crates, add_poster_board, add_rock, scatter
from epiprior_lab.scenes.facades import HouseStyle, add_facade, add_house
from epiprior_lab.scenes.settings import Bounds, FamilySettings
from epiprior_lab.scenes.textures import WallStyle, crop, foliage, noise, pavement, wall
from epiprior_lab.scenes.world import BOTH_VIEWS, FIRST_VIEW, SECOND_VIEW, Frame, Image, World, WorldBuilder, upright

_GROUND_M = 120.0
_GROUND_TILE_M = 10.0
_ROWS, _COLUMNS = 512, 1024  # of the surroundings

FACADE_TEXELS_PER_M = 56.0


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is photographed: cameras stand before the plane z = 0, `eye_m` above the ground, and aim at a place on it.

    `distance_m` (low, high) is that of the nearer camera, `obliquity_deg` the largest angle to the plane's normal.
    """

    distance_m: tuple[float, float]
    obliquity_deg: float
    aim_across_m: tuple[float, float]
    aim_up_m: tuple[float, float]
    eye_m: tuple[float, float]


def _begin_world(rng: Generator) -> WorldBuilder:
    world = WorldBuilder(surroundings=_surroundings(rng))
    ground = world.texture(pavement(rng, 768, 768, texels_per_m=768 / _GROUND_TILE_M))
    half, tiles = _GROUND_M / 2, _GROUND_M / _GROUND_TILE_M
    corner, across, down = (-half, 0.0, half), (_GROUND_M, 0.0, 0.0), (0.0, 0.0, -_GROUND_M)
    world.face(corner, across, down, ground, area=(0.0, 0.0, tiles, tiles))
    corners, radius = 9, 0.48 * _GROUND_M  # of a ring of flat houses and trees at the rim of the ground
    textures = [world.texture(_row_of_houses(rng)) for _ in range(3)]
    for k in range(corners):
        angles = 2 * np.pi * k / corners, 2 * np.pi * (k + 1) / corners
        here, there = (radius * np.array([np.cos(a), 0.0, np.sin(a)]) for a in angles)
        high = rng.uniform(7, 13)
        # Seen from inside the ring the corners follow each other from right to left.
        world.face(there - [0.0, high, 0.0], here - there, (0.0, high, 0.0), textures[k % 3])
    return world


def _row_of_houses(rng: Generator) -> Image:
    """Return far houses between trees, shape (192, 640, 4), with sky above them."""
    height, width = 192, 640
    image = np.zeros((height, width, 4), dtype=np.uint8)
    x = 0
    while x < width:
        wide, top = int(rng.integers(50, 130)), int(rng.integers(10, 110))
        if rng.random() < 0.25:
            trees = foliage(rng, 128)
            image[height - 100 :, x : x + 128] = trees[14:114, : width - x]
            x += int(rng.integers(50, 110))
            continue
        house = wall(rng, height - top, wide, WallStyle(rng, distinct=0.5), texels_per_m=14.0)
        dark, step = (house[:1, :1] // 4).astype(np.uint8), int(rng.integers(16, 26))
        for y in range(12, house.shape[0] - 14, step + 6):
            for left in range(6, wide - 12, step):
                house[y : y + 14, left : left + 9] = dark
        image[top:, x : x + wide, :3], image[top:, x : x + wide, 3] = house[:, : width - x], 255
        x += wide
    return image


def _surroundings(rng: Generator) -> Image:
    """Return a picture of all directions, (512, 1024, 3): zenith in the first row, horizon in the middle."""
    half = _ROWS // 2
    zenith = np.array(((92, 130, 186), (150, 160, 172), (118, 148, 190))[int(rng.integers(3))], dtype=np.float32)
    horizon = np.array((206, 212, 216), dtype=np.float32)
    part = np.linspace(0, 1, half, dtype=np.float32)[:, None, None] ** 1.5
    sky = np.repeat(zenith * (1 - part) + horizon * part, _COLUMNS, axis=1)
    clouds = cv2.GaussianBlur(np.ascontiguousarray(noise(rng, half, _COLUMNS, "coarse")), (0, 0), 2.0)
    cover = np.clip(rng.uniform(-0.6, 0.5) + 0.7 * clouds, 0, 1)[..., None]
    sky = sky * (1 - 0.8 * cover) + 236 * 0.8 * cover
    ground = np.full((half, _COLUMNS, 3), 112, dtype=np.float32)
    image = np.concatenate([sky, ground])
    image[half - 40 : half + 10] = _skyline(rng, image[half - 40 : half + 10])
    return np.asarray(np.clip(image, 0, 255), dtype=np.uint8)


def _skyline(rng: Generator, band: np.ndarray) -> np.ndarray:
    """Draw the other side of the street, blurred: it is seen only as a reflection or behind everything."""
    height, width = band.shape[:2]
    out = np.array(band, dtype=np.float32)
    x = 0
    while x < width:
        wide, high = int(rng.integers(20, 80)), int(rng.integers(12, height - 8))
        view = crop(rng, height, wide, ("china", "rocket", "motorcycle", "camera"), part=(0.4, 1.0))
        part = out[height - high :, x : x + wide]
        part[:] = 0.35 * part + 0.5 * view[height - high :, : part.shape[1]]
        x += wide + int(rng.integers(0, 40))
    return np.asarray(cv2.GaussianBlur(out, (0, 0), 1.2))


def draw_street(rng: Generator, settings: FamilySettings, style: HouseStyle | None = None) -> tuple[World, Subject]:
    """Draw a street with a facade about 20 m wide, of a style if one is given, in one to three parts that stand out."""
    world = _begin_world(rng)
    style = style or HouseStyle(rng, settings, FACADE_TEXELS_PER_M)
    width, height = rng.uniform(16, 25), rng.uniform(9, 16)
    frame = Frame.facing((-width / 2, 0.0, 0.0), 0.0)
    parts = int(rng.integers(1, 4))
    borders = np.concatenate([[0.0], np.sort(rng.uniform(0.25, 0.75, size=parts - 1)), [1.0]]) * width
    if parts > 1 and np.diff(borders).min() < 3.0:
        borders = np.linspace(0.0, width, parts + 1)
    for k, (left, right) in enumerate(pairwise(borders.tolist())):
        forward = rng.uniform(0.4, 1.4) if k % 2 == 1 or (parts == 2 and rng.random() < 0.5) else 0.0
        part = Frame(frame.point(left, 0.0, forward), frame.right, frame.outward)
        add_facade(world, rng, part, style, width=right - left, height=height)
        _add_returns(world, rng, part, width=right - left, height=height, depth=forward + 0.3)
    _add_neighbours(world, rng, frame, settings, width=width)
    across, before = (-0.55 * width, 0.55 * width), (2.0, 7.0)
    scatter(world, rng, FURNITURE, count=int(rng.integers(3, 8)), across=across, before=before, view=BOTH_VIEWS)
    _add_passing(world, rng, settings, across=across, before=before)
    subject = Subject(
        distance_m=(11.0, 18.0),
        obliquity_deg=55.0,
        aim_across_m=(-0.2 * width, 0.2 * width),
        aim_up_m=(2.0, 0.55 * height),
        eye_m=(1.5, 3.5),
    )
    return world.build(), subject


def _add_returns(
    world: WorldBuilder, rng: Generator, frame: Frame, *, width: float, height: float, depth: float
) -> None:
    """Close a part that stands forward on both sides, with a wall of its own masonry."""
    style = WallStyle(rng, distinct=0.3)
    texture = world.texture(wall(rng, int(24 * height), max(8, int(24 * depth)), style, texels_per_m=24.0))
    for side in (frame.side(width), frame.left_side(-depth)):
        upright(world, side, (0.0, depth), (0.0, height), 0.0, texture=texture)


def _add_neighbours(
    world: WorldBuilder, rng: Generator, frame: Frame, settings: FamilySettings, *, width: float
) -> None:
    """Add a house on either side, in line, set back, or standing forward so that its side is seen."""
    for side in (-1, 1):
        style = HouseStyle(rng, settings, 40.0)
        wide, forward = rng.uniform(7, 11), float(rng.choice((-3.0, -1.0, 0.8, 2.5, 4.0)))
        start = -wide - rng.uniform(0, 1.5) if side < 0 else width + rng.uniform(0, 1.5)
        place = Frame(frame.point(float(start), 0.0, forward), frame.right, frame.outward)
        add_house(world, rng, place, style, width=wide, height=rng.uniform(5, 12), depth=8.0)


def _add_passing(
    world: WorldBuilder, rng: Generator, settings: FamilySettings, *, across: Bounds, before: Bounds
) -> None:
    for view in (FIRST_VIEW, SECOND_VIEW):
        count = round(rng.uniform(*settings.passing))
        scatter(world, rng, PASSING, count=count, across=across, before=before, view=view)


def draw_open_scene(rng: Generator, settings: FamilySettings) -> tuple[World, Subject]:
    """Draw a place about 25 m wide: houses behind, single things before them, some close to the viewer."""
    world = _begin_world(rng)
    across = -16.0
    while across < 14.0:
        wide, turn = rng.uniform(4, 9), rng.uniform(-35, 35)
        style = HouseStyle(rng, settings, 48.0)
        place = Frame.facing((across, 0.0, rng.uniform(2, 10)), turn)
        height, depth = rng.uniform(3, 8), rng.uniform(4, 7)
        add_house(world, rng, place, style, width=wide, height=height, depth=depth)
        across += wide + rng.uniform(1.5, 5.0)
    features = (add_rock, add_crates, add_poster_board)
    scatter(world, rng, features, count=5, across=(-4.0, 4.0), before=(-1.5, 3.5), view=BOTH_VIEWS)
    count = int(rng.integers(8, 15))
    scatter(world, rng, FURNITURE, count=count, across=(-9.0, 9.0), before=(-6.0, 4.0), view=BOTH_VIEWS)
    _add_passing(world, rng, settings, across=(-6.0, 6.0), before=(0.5, 4.0))
    subject = Subject(
        distance_m=(7.0, 11.0), obliquity_deg=70.0, aim_across_m=(-2.5, 2.5), aim_up_m=(1.0, 2.2), eye_m=(1.4, 3.0)
    )
    return world.build(), subject
