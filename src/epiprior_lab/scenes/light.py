"""Light: where the sun stands, and what it reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.types import Float32Array, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """How a place is lit when a picture is taken.

    Parameters
    ----------
    to_sun : ndarray, shape (3,)
        Unit vector towards the sun.
    ambient : float
        Brightness without sun, in [0, 1]; 1 under an overcast sky.
    """

    to_sun: FloatArray
    ambient: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Shadows:
    """What the sun sees.

    Parameters
    ----------
    projection : ndarray, shape (3, 4), float64
        From homogeneous world points to pixels of `depth`.
    depth : ndarray, shape (N, N), float32
        Distance of the lit surface from the sun, metres.
    """

    projection: FloatArray
    depth: Float32Array


def draw_light(rng: np.random.Generator) -> Light:
    """Draw sunshine, or in a quarter of the cases an overcast sky."""
    direction = np.array([rng.uniform(-1.0, 1.0), -rng.uniform(0.45, 1.3), -rng.uniform(0.25, 1.0)])
    overcast = rng.random() < 0.25
    ambient = float(rng.uniform(0.8, 0.9) if overcast else rng.uniform(0.42, 0.62))
    return Light(to_sun=direction / np.linalg.norm(direction), ambient=ambient)
