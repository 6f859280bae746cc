"""Rocks and statues: bumpy balls of triangles, for surfaces that are not flat."""

from __future__ import annotations

import cv2
import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.scenes.materials import jittered, wall, wall_style
from epiprior_lab.scenes.placing import random_frame
from epiprior_lab.scenes.textures import SURFACES, noise, surface, tinted
from epiprior_lab.scenes.world import BOTH_VIEWS, Vector, WorldBuilder, box


def add_rock(world: WorldBuilder, rng: np.random.Generator, position: Vector, views: int = BOTH_VIEWS) -> None:
    """Add a rock or statue: a bumpy ball of triangles, on a pedestal at times."""
    radius = float(rng.uniform(0.35, 0.9))
    relief = 0.22 * surface(rng, 256, 512, SURFACES, zoom=float(rng.uniform(0.6, 1.5))) + 0.16 * noise(
        rng, 256, 512, "middle"
    )
    texture = world.texture(tinted(jittered(rng, (148, 140, 126), 0.3), relief))
    frame, base = random_frame(rng, position), 0.0
    if rng.random() < 0.5:
        base = float(rng.uniform(0.5, 1.4))
        plinth = world.texture(wall(rng, 128, 160, wall_style(rng, distinct=0.6), texels_per_m=100.0))
        box(
            world,
            frame,
            (-0.8 * radius, 0.8 * radius),
            (0.0, base),
            (-0.8 * radius, 0.8 * radius),
            textures=plinth,
            views=views,
        )
    points = _bumpy_ball(rng, radius, stretch=float(rng.uniform(0.8, 1.8)))
    centre = frame.point(0.0, base + 0.8 * radius)
    rows, columns = points.shape[0] - 1, points.shape[1] - 1
    for i in range(rows):
        for j in range(columns):
            p = points[i : i + 2, j : j + 2] + centre
            u, v, du, dv = j / columns, i / rows, 1 / columns, 1 / rows
            upper = np.array([[u, v], [du, 0.0], [0.0, dv]])
            lower = np.array([[u + du, v + dv], [-du, 0.0], [0.0, -dv]])
            world.face(
                p[0, 0],
                p[0, 1] - p[0, 0],
                p[1, 0] - p[0, 0],
                texture,
                texture_frame=upper,
                triangle=True,
                views=views,
            )
            world.face(
                p[1, 1],
                p[1, 0] - p[1, 1],
                p[0, 1] - p[1, 1],
                texture,
                texture_frame=lower,
                triangle=True,
                views=views,
            )


def _bumpy_ball(rng: np.random.Generator, radius: float, *, stretch: float) -> FloatArray:
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
