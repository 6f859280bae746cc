"""Shadows: what the sun sees of a world."""

from __future__ import annotations

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.pairsets import Camera
from epiprior_lab.scenes.light import Light, Shadows
from epiprior_lab.scenes.render import render_depth
from epiprior_lab.scenes.world import World

_MAP_SIDE = 1280
_SUN_DISTANCE_M = 400.0
_REACH_M = 32.0


def cast_shadows(world: World, light: Light, middle: FloatArray, *, view: int) -> Shadows:
    """Return what a sun 400 m away sees within about 30 m of `middle`."""
    eye = middle + _SUN_DISTANCE_M * light.to_sun
    forward = -light.to_sun
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal, centre = 0.5 * _MAP_SIDE * _SUN_DISTANCE_M / _REACH_M, (_MAP_SIDE - 1) / 2
    K = np.array([[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]])
    sun = Camera(K=K, R=R, t=-R @ eye, width=_MAP_SIDE, height=_MAP_SIDE)
    projection = np.column_stack([K @ sun.R, K @ sun.t])
    return Shadows(projection=projection, depth=render_depth(world, sun, view=view))
