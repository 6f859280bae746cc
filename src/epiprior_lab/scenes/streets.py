"""Streets: a large facade in parts, its neighbours, pavement, and what stands before it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from epiprior_lab.scenes.camera_pairs import Subject
from epiprior_lab.scenes.clutter import FURNITURE, PASSING
from epiprior_lab.scenes.facades import add_facade, add_house, house_style
from epiprior_lab.scenes.materials import foliage, pavement, wall, wall_style
from epiprior_lab.scenes.placing import scatter
from epiprior_lab.scenes.settings import FamilySettings
from epiprior_lab.scenes.surroundings import draw_surroundings
from epiprior_lab.scenes.world import BOTH_VIEWS, FIRST_VIEW, SECOND_VIEW, Frame, Image, World, WorldBuilder, upright

_TEXELS_PER_M = 56.0
_GROUND_M = 120.0
_GROUND_TILE_M = 10.0


def begin_world(rng: np.random.Generator) -> WorldBuilder:
    """Return a world with sky, ground and what stands at its rim."""
    world = WorldBuilder(surroundings=draw_surroundings(rng))
    side = 768
    ground = world.texture(pavement(rng, side, side, texels_per_m=side / _GROUND_TILE_M))
    half, tiles = _GROUND_M / 2, _GROUND_M / _GROUND_TILE_M
    corner, across, down = (-half, 0.0, half), (_GROUND_M, 0.0, 0.0), (0.0, 0.0, -_GROUND_M)
    world.face(corner, across, down, ground, area=(0.0, 0.0, tiles, tiles))
    _add_backdrop(world, rng)
    return world


def _add_backdrop(world: WorldBuilder, rng: np.random.Generator) -> None:
    """Add a ring of flat houses and trees at the rim of the ground."""
    corners, radius = 9, 0.48 * _GROUND_M
    textures = [world.texture(_row_of_houses(rng)) for _ in range(3)]
    for k in range(corners):
        here, there = (
            radius * np.array([np.cos(a), 0.0, np.sin(a)])
            for a in (2 * np.pi * k / corners, 2 * np.pi * (k + 1) / corners)
        )
        high = float(rng.uniform(7, 13))
        # Seen from inside the ring the corners follow each other from right to left.
        world.face(there - [0.0, high, 0.0], here - there, (0.0, high, 0.0), textures[k % 3])


def _row_of_houses(rng: np.random.Generator) -> Image:
    """Return far houses between trees, shape (192, 640, 4), with sky above them."""
    height, width = 192, 640
    image = np.zeros((height, width, 4), dtype=np.uint8)
    x = 0
    while x < width:
        wide, top = int(rng.integers(50, 130)), int(rng.integers(10, 110))
        if rng.random() < 0.25:
            trees = foliage(rng, 128)
            right = min(x + 128, width)
            image[height - 100 :, x:right] = trees[14:114, : right - x]
            x += int(rng.integers(50, 110))
            continue
        house = wall(rng, height - top, wide, wall_style(rng, distinct=0.5), texels_per_m=14.0)
        dark, step = (house[:1, :1] // 4).astype(np.uint8), int(rng.integers(16, 26))
        for y in range(12, house.shape[0] - 14, step + 6):
            for left in range(6, wide - 12, step):
                house[y : y + 14, left : left + 9] = dark
        right = min(x + wide, width)
        image[top:, x:right, :3], image[top:, x:right, 3] = house[:, : right - x], 255
        x += wide
    return image


def draw_street(rng: np.random.Generator, settings: FamilySettings) -> tuple[World, Subject]:
    """Draw a street with a facade about 20 m wide, in one to three parts that stand out from each other."""
    world = begin_world(rng)
    distinct, variety = float(rng.uniform(*settings.distinct)), float(rng.uniform(*settings.variety))
    style = house_style(rng, distinct=distinct, variety=variety, texels_per_m=_TEXELS_PER_M)
    width, height = float(rng.uniform(16, 25)), float(rng.uniform(9, 16))
    frame = Frame.facing((-width / 2, 0.0, 0.0), 0.0)
    parts = int(rng.integers(1, 4))
    borders = np.concatenate([[0.0], np.sort(rng.uniform(0.25, 0.75, size=parts - 1)), [1.0]]) * width
    if parts > 1 and np.diff(borders).min() < 3.0:
        borders = np.linspace(0.0, width, parts + 1)
    for k, (left, right) in enumerate(pairwise(borders.tolist())):
        forward = float(rng.uniform(0.4, 1.4)) if k % 2 == 1 or (parts == 2 and rng.random() < 0.5) else 0.0
        part = Frame(frame.point(left, 0.0, forward), frame.right, frame.outward)
        add_facade(world, rng, part, style, width=right - left, height=height)
        _add_returns(world, rng, part, width=right - left, height=height, depth=forward + 0.3)
    _add_neighbours(world, rng, frame, settings, width=width)
    across, before = (-0.55 * width, 0.55 * width), (2.0, 7.0)
    scatter(world, rng, FURNITURE, count=int(rng.integers(3, 8)), across=across, before=before, view=BOTH_VIEWS)
    for view in (FIRST_VIEW, SECOND_VIEW):
        count = round(rng.uniform(*settings.passing))
        scatter(world, rng, PASSING, count=count, across=across, before=before, view=view)
    subject = Subject(
        frame=Frame(np.zeros(3), frame.right, frame.outward),
        distance_m=(11.0, 18.0),
        obliquity_deg=55.0,
        aim_across_m=(-0.2 * width, 0.2 * width),
        aim_up_m=(2.0, 0.55 * height),
        eye_m=(1.5, 3.5),
    )
    return world.build(), subject


def _add_returns(
    world: WorldBuilder, rng: np.random.Generator, frame: Frame, *, width: float, height: float, depth: float
) -> None:
    """Close a part that stands forward on both sides, with a wall of its own masonry."""
    texture = world.texture(
        wall(rng, int(24 * height), max(8, int(24 * depth)), wall_style(rng, distinct=0.3), texels_per_m=24.0)
    )
    upright(world, frame.side(width), (0.0, depth), (0.0, height), 0.0, texture=texture)
    left = Frame(frame.point(0.0, 0.0, -depth), frame.outward, -frame.right)
    upright(world, left, (0.0, depth), (0.0, height), 0.0, texture=texture)


def _add_neighbours(
    world: WorldBuilder, rng: np.random.Generator, frame: Frame, settings: FamilySettings, *, width: float
) -> None:
    """Add a house on either side, in line, set back, or standing forward so that its side is seen."""
    for side in (-1, 1):
        style = house_style(
            rng,
            distinct=float(rng.uniform(*settings.distinct)),
            variety=float(rng.uniform(*settings.variety)),
            texels_per_m=40.0,
        )
        wide, forward = float(rng.uniform(7, 11)), float(rng.choice((-3.0, -1.0, 0.8, 2.5, 4.0)))
        start = -wide - rng.uniform(0, 1.5) if side < 0 else width + rng.uniform(0, 1.5)
        place = Frame(frame.point(float(start), 0.0, forward), frame.right, frame.outward)
        add_house(world, rng, place, style, width=wide, height=float(rng.uniform(5, 12)), depth=8.0)
