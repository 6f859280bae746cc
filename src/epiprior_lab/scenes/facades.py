"""Houses: walls with recessed windows, sills, cornices, balconies, pipes, roofs."""

import copy

import cv2
import numpy as np
from numpy.random import Generator

from epiprior_lab.scenes.details import WindowStyle, door, draw_panes, draw_trim, paint_details, poster
from epiprior_lab.scenes.settings import FamilySettings
from epiprior_lab.scenes.textures import WallStyle, foliage, jittered, noise, ornament, roof, tinted, wall
from epiprior_lab.scenes.world import Colour, Frame, Image, Span, WorldBuilder, box, upright

_CORNICE_REPEAT_M = 2.0
Opening = tuple[float, float, float, float]


class HouseStyle:
    """What the walls of a house of a family have in common.

    Windows are `storey_m` and `bay_m` from each other, and `recess_m` deep in the wall, metres; `balconies` is the
    share of the windows that have one, `details` the number of single things (posters, stains, ...) per square metre.
    """

    def __init__(self, rng: Generator, settings: FamilySettings, texels_per_m: float) -> None:
        distinct, variety = rng.uniform(*settings.distinct), rng.uniform(*settings.variety)
        self.wall = WallStyle(rng, distinct=distinct)
        self.window = WindowStyle(rng, self.wall.colour, variety=variety)
        gap = (1.1 if self.window.shutters else 0.45) * self.window.width_m
        self.storey_m = self.window.height_m + rng.uniform(0.8, 1.4)
        self.bay_m = self.window.width_m + gap + rng.uniform(0.1, 0.7)
        self.recess_m = rng.uniform(0.10, 0.35)
        self.balconies = float(rng.choice((0.0, 0.0, 0.2, 0.4, 0.7)))
        self.cornices = rng.random() < 0.6
        self.details = float(rng.uniform(0.01, 0.03) + 0.10 * distinct**1.5)
        self.texels_per_m = texels_per_m


def add_house(
    world: WorldBuilder, rng: Generator, frame: Frame, style: HouseStyle, *, width: float, height: float, depth: float
) -> None:
    """Add a house whose front stands on `frame`: front, both sides, and a roof."""
    add_facade(world, rng, frame, style, width=width, height=height)
    simple = copy.copy(style)
    simple.details, simple.texels_per_m = style.details / 2, 0.6 * style.texels_per_m
    add_facade(world, rng, frame.side(width), simple, width=depth, height=height)
    add_facade(world, rng, frame.left_side(-depth), simple, width=depth, height=height)
    _add_roof(world, rng, frame, width=width, height=height, depth=depth)


def add_facade(
    world: WorldBuilder, rng: Generator, frame: Frame, style: HouseStyle, *, width: float, height: float
) -> None:
    """Add one wall with everything on it."""
    scale = style.texels_per_m
    rows, columns = max(8, int(height * scale)), max(8, int(width * scale))
    outside = np.full((rows, columns, 4), 255, dtype=np.uint8)
    outside[..., :3] = wall(rng, rows, columns, style.wall, texels_per_m=scale)
    inside = np.full((rows, columns, 4), 255, dtype=np.uint8)
    windows, entrances = _openings(rng, style, width=width, height=height)
    openings = [*windows, *entrances]
    areas = [
        (round(a0 * scale), round((height - b1) * scale), round(a1 * scale), round((height - b0) * scale))
        for a0, b0, a1, b1 in openings
    ]
    trim, carving = style.window.trim_colour, None
    if style.window.lintel == "carved":
        carving = ornament(rng, int(0.42 * scale), int((style.window.width_m + 0.2) * scale), trim)
    for left, top, right, bottom in areas[: len(windows)]:
        draw_panes(rng, inside[top:bottom, left:right], style.window, texels_per_m=scale)
        draw_trim(rng, outside, (left, top, right, bottom), style.window, carving, scale)
    for left, top, right, bottom in areas[len(windows) :]:
        inside[top:bottom, left:right] = door(rng, bottom - top, right - left)
        cv2.rectangle(outside, (left - 4, top - 4), (right + 3, bottom), (*trim, 255), 8)
    paint_details(rng, outside, count=int(style.details * width * height), texels_per_m=scale)
    for left, top, right, bottom in areas:
        outside[top:bottom, left:right, 3] = 0
    front, behind = world.texture(outside), world.texture(inside)
    upright(world, frame, (0.0, width), (0.0, height), 0.0, texture=front)
    upright(world, frame, (0.0, width), (0.0, height), -style.recess_m, texture=behind, mirror=0.45)
    stone = world.texture(_stone(rng, trim))
    for a0, b0, a1, b1 in openings:  # the four faces between the wall and a recessed window
        down, inward, wide = np.array([0.0, b1 - b0, 0.0]), -style.recess_m * frame.outward, (a1 - a0) * frame.right
        world.face(frame.point(a0, b1), inward, down, stone)
        world.face(frame.point(a1, b1, -style.recess_m), -inward, down, stone)
        world.face(frame.point(a0, b0, -style.recess_m), wide, -inward, stone)
        world.face(frame.point(a0, b1), wide, inward, stone, brightness=0.8)
    _add_relief(world, rng, frame, style, windows, stone, (width, height))


def _openings(rng: Generator, style: HouseStyle, *, width: float, height: float) -> tuple[list[Opening], list[Opening]]:
    """Return windows and entrances (a0, b0, a1, b1): a grid with gaps, doors and shops at its foot."""
    window = style.window
    bays, storeys = int((width - 0.4) // style.bay_m), max(1, int((height - 0.5) // style.storey_m))
    margin = 0.5 * (width - bays * style.bay_m)
    windows: list[Opening] = []
    entrances: list[Opening] = []
    for storey in range(storeys):
        foot = storey * style.storey_m + 0.42 * (style.storey_m - window.height_m) + 0.25
        if foot + window.height_m > height - 0.2:
            continue
        for bay in range(bays):
            middle = margin + (bay + 0.5) * style.bay_m
            chance = rng.random()
            if storey == 0 and chance < 0.3:
                half = 0.5 * min(rng.uniform(1.0, 2.4), style.bay_m - 0.4)
                entrances.append((middle - half, 0.05, middle + half, min(2.5, style.storey_m - 0.2)))
            elif chance < 0.96:
                windows.append((middle - window.width_m / 2, foot, middle + window.width_m / 2, foot + window.height_m))
    return windows, entrances


def _stone(rng: Generator, colour: Colour) -> Image:
    return tinted(colour, 0.06 * noise(rng, 64, 128, "fine") + 0.05 * noise(rng, 64, 128, "middle"))


def _add_relief(
    world: WorldBuilder, rng: Generator, frame: Frame, style: HouseStyle, windows: list[Opening], stone: int, size: Span
) -> None:
    """Add what stands out from the wall: sills, balconies, flower boxes, coolers, cornices, pipes, signs."""
    width, height = size
    rail = world.texture(_railing(rng, style))
    plants = world.texture(foliage(rng, 96))
    metal = world.texture(_stone(rng, jittered(rng, (150, 152, 154), 0.25)))
    for a0, b0, a1, _ in windows:
        box(world, frame, (a0 - 0.12, a1 + 0.12), (b0 - 0.09, b0), (0.0, 0.13), textures=stone)
        chance = rng.random()
        if b0 > style.storey_m and chance < style.balconies:
            _add_balcony(world, frame, (a0 - 0.35, a1 + 0.35), b0 - 0.15, stone=stone, rail=rail)
        elif chance > 1.0 - 0.25 * style.window.variety:
            box(world, frame, (a0, a1), (b0, b0 + 0.38), (0.05, 0.3), textures=plants)
        elif chance > 1.0 - 0.32 * style.window.variety:
            low = b0 - 0.6
            box(world, frame, (a1 - 0.7, a1), (low, low + 0.5), (0.02, 0.35), textures=metal)
    heights = [height - 0.25]
    if style.cornices:
        heights += [storey * style.storey_m for storey in range(1, int((height - 0.8) // style.storey_m) + 1)]
    moulding = world.texture(_moulding(rng, style))
    for k, b in enumerate(heights):
        high, far = (0.32, 0.4) if k == 0 else (0.16, 0.14)
        area = (0.0, 0.0, width / _CORNICE_REPEAT_M, 1.0)
        box(world, frame, (0.0, width), (b, b + high), (0.0, far), textures=(moulding, stone, stone), area=area)
    for _ in range(int(rng.integers(0, 3))):
        a = float(rng.uniform(0.05, 0.95) * width)
        box(world, frame, (a, a + 0.11), (0.0, height), (0.02, 0.13), textures=metal)
    if width * height > 60:  # a sign
        picture = world.texture(poster(rng, 160, 120))
        a, b = float(rng.uniform(0.1, 0.9) * width), rng.uniform(1.0, 3.5)
        box(world, frame, (a, a + 0.1), (b, b + 1.0), (0.15, 0.95), textures=(metal, picture, metal))


def _add_balcony(world: WorldBuilder, frame: Frame, a: Span, b: float, *, stone: int, rail: int) -> None:
    """Add a slab with a railing on three sides."""
    far = 0.9
    box(world, frame, a, (b - 0.15, b), (0.0, far), textures=stone)
    upright(world, frame, a, (b, b + 0.95), far, texture=rail, area=(0.0, 0.0, a[1] - a[0], 1.0))
    for side in (frame.side(a[0], far), frame.side(a[1], far)):
        upright(world, side, (0.0, far), (b, b + 0.95), 0.0, texture=rail, area=(0.0, 0.0, far, 1.0))


def _railing(rng: Generator, style: HouseStyle) -> Image:
    """Return a metre of railing, shape (96, 96, 4): bars, crosses, balusters or a plate."""
    image = np.zeros((96, 96, 4), dtype=np.uint8)
    dark = (*jittered(rng, (52, 52, 54), 0.4), 255)
    image[:7] = image[-6:] = dark
    kind = rng.choice(("bars", "crosses", "balusters", "plate"))
    if kind == "plate":
        image[8:-8] = (*jittered(rng, style.wall.colour, 0.1), 255)
        image[14:-14:12, :, :3] //= 2
    for x in range(0, 96, 12 if kind == "bars" else 24):
        if kind == "bars":
            image[:, x : x + 4] = dark
        elif kind == "crosses":
            cv2.line(image, (x, 6), (x + 24, 90), dark, 3)
            cv2.line(image, (x + 24, 6), (x, 90), dark, 3)
        elif kind == "balusters":
            cv2.ellipse(image, (x + 12, 60), (9, 30), 0, 0, 360, (*style.window.trim_colour, 255), -1)
            cv2.rectangle(image, (x + 8, 6), (x + 15, 90), (*style.window.trim_colour, 255), -1)
    return image


def _moulding(rng: Generator, style: HouseStyle) -> Image:
    """Return two metres of cornice, shape (32, 160, 3), with or without dentils."""
    image = tinted(style.window.trim_colour, 0.07 * noise(rng, 32, 160, "fine"))
    image[10:12] //= 2
    image[24:26] = image[24:26] // 3 * 2
    if rng.random() < 0.6:
        for x in range(0, 160, 16):
            image[13:23, x : x + 7] //= 3
    return image


def _add_roof(world: WorldBuilder, rng: Generator, frame: Frame, *, width: float, height: float, depth: float) -> None:
    rise, eave = rng.uniform(0.15, 0.45) * depth, 0.5
    tiles = world.texture(roof(rng, 384, 512, texels_per_m=40.0))
    area = (0.0, 0.0, max(1.0, width / 12.0), 1.0)
    half = 0.5 * depth
    front, back = (np.array([0.0, rise, 0.0]) + side * half * frame.outward for side in (1, -1))
    ridge_left, ridge_right = frame.point(0.0, height + rise, -half), frame.point(width, height + rise, -half)
    world.face(ridge_left, width * frame.right, front * (1.0 + eave / half), tiles, area=area)
    world.face(ridge_right, -width * frame.right, back, tiles, area=area)
    for ridge in (ridge_left, ridge_right):
        world.face(ridge, front, back, tiles, triangle=True)
    bricks = world.texture(wall(rng, 96, 64, WallStyle(rng, distinct=0.5), texels_per_m=64.0))
    for _ in range(int(rng.integers(0, 4))):
        a = float(rng.uniform(0.05, 0.9) * width)
        box(world, frame, (a, a + 0.6), (height, height + rise + 0.9), (-half - 0.4, -half + 0.4), textures=bricks)
