"""Rows of made-up pairs for tests of the training: every scene has its own level, which leaks if split."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

COLUMNS = ("count", "ratio", "angle", "level", "noise")


@dataclass(frozen=True)
class Rows:
    """X float32 (N, 5), y bool (N,), scene and pair (N,) of str; two pairs per scene."""

    X: np.ndarray
    y: np.ndarray
    scene: np.ndarray
    pair: np.ndarray


@functools.cache
def make_rows(size: int = 2400, scenes: int = 12, seed: int = 0) -> Rows:
    rng = np.random.default_rng(seed)
    code = rng.integers(0, scenes, size)
    level = rng.normal(scale=1.5, size=scenes)
    X = np.column_stack(
        [
            rng.poisson(4, size),  # whole numbers: values that lie exactly on thresholds
            np.round(rng.normal(size=size), 2),
            rng.normal(size=size),
            code + 0.1 * rng.normal(size=size),  # tells the scene
            rng.normal(size=size),
        ]
    ).astype(np.float32)
    logit = 2 * X[:, 1] + np.sin(3 * X[:, 2]) - 0.4 * X[:, 0] + level[code] - 0.5
    y = logit + rng.logistic(size=size) > 0
    scene = np.array([f"scene-{number:02d}" for number in code])
    pair = np.array([f"{name}-{side}" for name, side in zip(scene, rng.integers(0, 2, size), strict=True)])
    return Rows(X, y, scene, pair)
