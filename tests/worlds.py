"""A small made-up world, and two cameras before it, for tests of rendering and of ground truth."""

from __future__ import annotations

import numpy as np

from epiprior_lab.pairsets import Camera
from epiprior_lab.scenes.camera_pairs import look_at
from epiprior_lab.scenes.render import Light, cast_shadows
from epiprior_lab.scenes.world import BOTH_VIEWS, Frame, World, WorldBuilder, box, upright
from pictures import texture

WIDTH, HEIGHT = 320, 240


def coloured(seed: int, side: int = 256):
    """Return a smooth picture, so that half a pixel makes no large difference."""
    return np.dstack([texture(side, side, seed + k) for k in range(3)])


def room(*, sky: bool = True) -> World:
    """Return a wall 12 m away, a box before it, and a floor."""
    builder = WorldBuilder(surroundings=np.full((64, 128, 3), 200, np.uint8))
    wall, crate, floor = (builder.texture(coloured(10 * k)) for k in range(3))
    high = 4.0 if sky else 40.0
    upright(builder, Frame.facing((-20.0, 0.0, 0.0), 0.0), (0.0, 40.0), (0.0, high), 0.0, texture=wall)
    box(builder, Frame.facing((-1.0, 0.0, -5.0), 0.0), (0.0, 2.0), (0.0, 2.0), (-2.0, 0.0), textures=crate)
    builder.face((-20.0, 0.0, 0.0), (40.0, 0.0, 0.0), (0.0, 0.0, -12.0), floor)
    return builder.build()


def camera_at(x: float, *, roll_deg: float = 0.0, z: float = -12.0) -> Camera:
    eye, target = np.array([x, -1.7, z]), np.array([0.0, -1.2, -2.0])
    return look_at(eye, target, roll_deg=roll_deg, focal_px=300.0, width=WIDTH, height=HEIGHT)


def no_shadows(world: World):
    return cast_shadows(world, OVERCAST_FROM_ASIDE, np.zeros(3), view=BOTH_VIEWS)


OVERCAST_FROM_ASIDE = Light(to_sun=np.array([0.6, -0.8, 0.0]), ambient=1.0)
