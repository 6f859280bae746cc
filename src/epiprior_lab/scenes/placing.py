"""How single things are placed: each is added to a world at a position, for some views."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from epiprior_lab.scenes.world import Frame, Vector, WorldBuilder

Placer = Callable[[WorldBuilder, np.random.Generator, Vector, int], None]


def random_frame(rng: np.random.Generator, position: Vector) -> Frame:
    """Return a frame at a position, turned at random."""
    return Frame.facing(position, float(rng.uniform(0, 360)))


def scatter(
    world: WorldBuilder,
    rng: np.random.Generator,
    placers: tuple[Placer, ...],
    *,
    count: int,
    across: tuple[float, float],
    before: tuple[float, float],
    view: int,
) -> None:
    """Add `count` things of random kinds, at random positions in a rectangle before the subject, for one view or both.

    `across` and `before` are bounds in metres, along the subject and away from it.
    """
    for _ in range(count):
        position = float(rng.uniform(*across)), 0.0, -float(rng.uniform(*before))
        placers[int(rng.integers(len(placers)))](world, rng, position, view)
