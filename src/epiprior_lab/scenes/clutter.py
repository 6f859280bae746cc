"""Things that stand about (trees, cars, passers-by, crates, boards, hedges, fences, rocks), and how they are placed."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.random import Generator

from epiprior.types import FloatArray
from epiprior_lab.scenes.details import DUPLEX, poster
from epiprior_lab.scenes.textures import WallStyle, crop, foliage, jittered, letters, noise, surface, tinted, wall
from epiprior_lab.scenes.world import BOTH_VIEWS, Colour, Frame, Image, Span, Vector, WorldBuilder, box, upright

Placers = tuple[Callable[[WorldBuilder, Generator, Vector], None], ...]


def random_frame(rng: Generator, position: Vector) -> Frame:
    """Return a frame at a position, turned at random."""
    return Frame.facing(position, rng.uniform(0, 360))


def scatter(
    world: WorldBuilder, rng: Generator, placers: Placers, count: int, across: Span, before: Span, view: int
) -> None:
    """Add `count` random things for one view or both within `across` (along the subject) and `before` it, metres."""
    world.views = view
    for _ in range(count):
        position = rng.uniform(*across), 0.0, -rng.uniform(*before)
        placers[int(rng.integers(len(placers)))](world, rng, position)
    world.views = BOTH_VIEWS


def add_tree(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a trunk and a crown of crossing sheets of leaves."""
    height, crown = rng.uniform(3.0, 6.5), rng.uniform(1.6, 3.2)
    bark = world.texture(tinted((92, 78, 62), 0.25 * surface(rng, 256, 48, ("gravel", "tissue"), zoom=0.7)))
    frame = random_frame(rng, position)
    box(world, frame, (-0.13, 0.13), (0.0, height - 0.3 * crown), (-0.13, 0.13), textures=bark)
    leaves = [world.texture(foliage(rng, 224)) for _ in range(2)]
    for k in range(7):
        sheet = random_frame(rng, frame.point(*rng.uniform(-0.22, 0.22, size=3) * crown))
        half = crown * rng.uniform(0.4, 0.55)
        middle = height + rng.uniform(-0.15, 0.15) * crown
        across, down = 2 * half * sheet.right, np.array([0.0, 2 * half, 0.0])
        down = down + rng.uniform(-0.5, 0.5) * half * sheet.outward
        world.face(sheet.point(-half, middle + half), across, down, leaves[k % 2])


def add_lamp(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a lamp post, with a sign on some."""
    metal = world.texture(tinted(jittered(rng, (84, 88, 88), 0.4), 0.08 * noise(rng, 256, 16, "middle")))
    frame, height = random_frame(rng, position), rng.uniform(3.0, 6.0)
    box(world, frame, (-0.06, 0.06), (0.0, height), (-0.06, 0.06), textures=metal)
    box(world, frame, (-0.1, 0.5), (height, height + 0.2), (-0.12, 0.12), textures=metal)
    if rng.random() < 0.6:
        sign = np.full((64, 96, 3), jittered(rng, (130, 120, 110), 0.8), dtype=np.uint8)
        ink = (24, 24, 28) if sign.mean() > 110 else (238, 234, 220)
        for y in (21, 42, 63):
            cv2.putText(sign, letters(rng, 9), (4, y), DUPLEX, 64 / 110, ink, 1, cv2.LINE_AA)
        cv2.rectangle(sign, (0, 0), (95, 63), ink, 2)
        box(world, frame, (-0.4, 0.4), (2.2, 2.75), (0.07, 0.1), textures=world.texture(sign))


def add_car(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a car or a van made of boxes; wheels, lights and windows are painted on."""
    colour = jittered(rng, (130, 126, 124), 0.9)
    frame = Frame.facing(position, rng.normal(0, 12))
    van = rng.random() < 0.3
    length, low, high = (5.2, 1.1, 2.3) if van else (4.3, 0.78, 1.42)
    side, front = world.texture(_car_side(rng, colour)), world.texture(_car_front(rng, colour))
    glass = world.texture(_car_windows(rng, colour))
    top = world.texture(tinted(colour, 0.03 * noise(rng, 64, 128, "coarse")))
    box(world, frame, (0.0, length), (0.18, low), (-1.7, 0.0), textures=(side, front, top))
    start = 0.2 if van else 1.0
    box(world, frame, (start, length - 0.5), (low, high), (-1.6, -0.1), textures=(glass, glass, top))


def _car_side(rng: Generator, colour: Colour) -> Image:
    image = tinted(colour, 0.04 * noise(rng, 96, 480, "coarse"))
    for x in (95, 385):
        cv2.circle(image, (x, 74), 40, (22, 22, 24), -1, cv2.LINE_AA)
        cv2.circle(image, (x, 74), 22, (168, 168, 172), -1, cv2.LINE_AA)
        for angle in range(0, 360, 60):
            end = (int(x + 20 * np.cos(np.deg2rad(angle))), int(74 + 20 * np.sin(np.deg2rad(angle))))
            cv2.line(image, (x, 74), end, (60, 60, 64), 4, cv2.LINE_AA)
    for x in (165, 250, 330):
        cv2.line(image, (x, 0), (x, 84), tuple(0.4 * c for c in colour), 2)
    cv2.line(image, (0, 30), (479, 24), tuple(0.7 * c for c in colour), 2)
    return image


def _car_front(rng: Generator, colour: Colour) -> Image:
    image = tinted(colour, 0.04 * noise(rng, 96, 200, "coarse"))
    cv2.rectangle(image, (60, 20), (140, 44), (30, 30, 32), -1)
    for x in (28, 172):
        cv2.ellipse(image, (x, 32), (20, 12), 0, 0, 360, (232, 230, 214), -1, cv2.LINE_AA)
    cv2.rectangle(image, (66, 58), (134, 78), (236, 234, 224), -1)
    cv2.putText(image, letters(rng, 6), (70, 74), DUPLEX, 0.5, (16, 16, 20), 1, cv2.LINE_AA)
    return image


def _car_windows(rng: Generator, colour: Colour) -> Image:
    image = np.asarray(crop(rng, 64, 256) // 4 + 18, dtype=np.uint8)
    for x in (0, 120, 248):
        image[:, x : x + 8] = colour
    image[:6] = image[-5:] = colour
    return image


def add_person(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a passer-by: a flat figure, clothed in parts of photographs."""
    image = np.zeros((192, 72, 4), dtype=np.uint8)
    image[..., :3] = crop(rng, 192, 72, part=(0.3, 0.8)) // 2 + np.uint8(20)
    image[110:, :, :3] = np.array(jittered(rng, (64, 66, 84), 0.6))
    shape = np.zeros((192, 72), dtype=np.uint8)
    cv2.ellipse(shape, (36, 18), (12, 16), 0, 0, 360, 255, -1)
    cv2.rectangle(shape, (14, 38), (58, 112), 255, -1)
    cv2.ellipse(shape, (36, 44), (24, 12), 0, 0, 360, 255, -1)
    cv2.fillPoly(shape, [np.array([(18, 110), (54, 110), (60, 191), (44, 191), (36, 124), (26, 191), (10, 191)])], 255)
    cv2.ellipse(image, (36, 18), (12, 16), 0, 0, 360, (202, 158, 132, 255), -1)
    image[..., 3] = shape
    frame = Frame.facing(position, rng.normal(0, 25))
    half = 0.34 * rng.uniform(0.9, 1.15)
    upright(world, frame, (-half, half), (0.0, 5.3 * half), 0.0, texture=world.texture(image))


def add_crates(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a pile of boxes with pictures on them."""
    frame = random_frame(rng, position)
    bottom, half = 0.0, rng.uniform(0.35, 0.9)
    for _ in range(int(rng.integers(1, 4))):
        high = rng.uniform(0.7, 1.5) * half
        front, sides, top = (world.texture(_crate_side(rng)) for _ in range(3))
        extent = (-half, half)
        box(world, frame, extent, (bottom, bottom + high), extent, textures=(front, sides, top))
        bottom += high
        half *= rng.uniform(0.6, 0.95)
        frame = random_frame(rng, frame.point(*rng.uniform(-0.15, 0.15, size=2) * [half, 0]))


def _crate_side(rng: Generator) -> Image:
    """Return one side of a box: cardboard, wood, a picture or masonry."""
    if rng.random() < 0.6:
        return poster(rng, 176, 192) if rng.random() < 0.5 else crop(rng, 176, 192, part=(0.5, 1.0))
    return wall(rng, 176, 192, WallStyle(rng, distinct=0.8), texels_per_m=120.0)


def add_poster_board(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a board on two posts with a poster on each side."""
    frame = Frame.facing(position, rng.uniform(-50, 50))
    wide, low = rng.uniform(0.8, 2.6), rng.uniform(0.3, 1.0)
    high = low + wide * rng.uniform(0.6, 1.2)
    post = world.texture(tinted((96, 92, 88), 0.1 * noise(rng, 96, 16, "middle")))
    front = world.texture(poster(rng, int(260 * (high - low) / wide) + 20, 260))
    box(world, frame, (0.0, wide), (low, high), (-0.06, 0.0), textures=(front, post, post))
    for a in (0.1, wide - 0.2):
        box(world, frame, (a, a + 0.08), (0.0, low), (-0.06, 0.0), textures=post)


def add_hedge(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a clipped hedge."""
    relief = 0.3 * surface(rng, 128, 384, ("grass", "gravel"), zoom=0.6) + 0.2 * noise(rng, 128, 384, "middle")
    leaves = world.texture(tinted(jittered(rng, (74, 96, 48), 0.25), relief))
    frame = Frame.facing(position, rng.normal(0, 20))
    length, high = rng.uniform(1.5, 5), rng.uniform(0.5, 1.3)
    box(world, frame, (0.0, length), (0.0, high), (-0.6, 0.0), textures=leaves)


def add_fence(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a fence of equal bars."""
    image = np.zeros((96, 96, 4), dtype=np.uint8)
    colour = (*jittered(rng, (110, 96, 80), 0.5), 255)
    image[12:20] = image[72:80] = colour
    for x in range(4, 96, 24):
        image[:, x : x + int(rng.integers(5, 14))] = colour
    image[..., :3] = np.clip(image[..., :3] * (1 + 0.1 * noise(rng, 96, 96, "fine"))[..., None], 0, 255)
    frame, length = Frame.facing(position, rng.normal(0, 25)), rng.uniform(2.5, 6.0)
    area = (0.0, 0.0, length, 1.0)
    upright(world, frame, (0.0, length), (0.0, 1.0), 0.0, texture=world.texture(image), area=area)


def add_rock(world: WorldBuilder, rng: Generator, position: Vector) -> None:
    """Add a rock or statue: a bumpy ball of triangles, on a pedestal at times."""
    radius = rng.uniform(0.35, 0.9)
    relief = 0.22 * surface(rng, 256, 512, zoom=rng.uniform(0.6, 1.5)) + 0.16 * noise(rng, 256, 512, "middle")
    texture = world.texture(tinted(jittered(rng, (148, 140, 126), 0.3), relief))
    frame, base = random_frame(rng, position), 0.0
    if rng.random() < 0.5:
        base = rng.uniform(0.5, 1.4)
        plinth = world.texture(wall(rng, 128, 160, WallStyle(rng, distinct=0.6), texels_per_m=100.0))
        square = (-0.8 * radius, 0.8 * radius)
        box(world, frame, square, (0.0, base), square, textures=plinth)
    points = _bumpy_ball(rng, radius, stretch=rng.uniform(0.8, 1.8))
    centre = frame.point(0.0, base + 0.8 * radius)
    rows, columns = points.shape[0] - 1, points.shape[1] - 1
    for i, j in np.ndindex(rows, columns):
        (p00, p01), (p10, p11) = points[i : i + 2, j : j + 2] + centre
        u, v, du, dv = j / columns, i / rows, 1 / columns, 1 / rows
        upper = np.array([[u, v], [du, 0.0], [0.0, dv]])
        lower = np.array([[u + du, v + dv], [-du, 0.0], [0.0, -dv]])
        world.face(p00, p01 - p00, p10 - p00, texture, texture_frame=upper, triangle=True)
        world.face(p11, p10 - p11, p01 - p11, texture, texture_frame=lower, triangle=True)


def _bumpy_ball(rng: Generator, radius: float, *, stretch: float) -> FloatArray:
    """Return points on a ball with dents, shape (13, 21, 3): from the top down, and around as seen from outside."""
    rows, columns = 12, 20
    bumps = cv2.GaussianBlur(rng.standard_normal((rows + 1, columns)), (0, 0), 0.8, borderType=cv2.BORDER_REFLECT)
    bumps = 1.0 + 0.4 * bumps
    bumps[0], bumps[-1] = 1.0, 1.0
    bumps = np.column_stack([bumps, bumps[:, 0]])
    polar = np.linspace(0, np.pi, rows + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, columns + 1)[None]
    x, z = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around)
    y = -stretch * np.cos(polar) * np.ones_like(around)
    return np.asarray(radius * bumps[..., None] * np.stack([x, y, z], axis=-1))


FURNITURE: Placers = (
    add_tree, add_lamp, add_car, add_crates, add_poster_board, add_hedge, add_fence, add_rock,
)  # fmt: skip
"""What stands in the street or garden in both views."""
PASSING: Placers = (add_person, add_person, add_car, add_tree, add_poster_board)
"""What may stand in one view only."""
