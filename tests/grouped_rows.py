"""Rows of made-up pairs for tests of the training: every scene has its own level, which leaks if split."""

import functools

import numpy as np

from epiprior_lab.training.samples import Sample, TargetRows

COLUMNS = ("count", "ratio", "angle", "level", "noise")


@functools.cache
def make_rows(size: int = 2400, scenes: int = 12, seed: int = 0, target: str = "match") -> TargetRows:
    """Return rows (N, 5) of two pairs per scene, ``scene-00-0``, ``scene-00-1``, ``scene-01-0``, ..."""
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
    y = 2 * X[:, 1] + np.sin(3 * X[:, 2]) - 0.4 * X[:, 0] + level[code] - 0.5 + rng.logistic(size=size) > 0
    pair = 2 * code + rng.integers(0, 2, size)
    samples = [
        Sample(scene=f"scene-{k // 2:02d}", pair=f"scene-{k // 2:02d}-{k % 2}", rows=X[pair == k], labels=y[pair == k],
               size=np.count_nonzero(pair == k))
        for k in range(2 * scenes)
    ]  # fmt: skip
    return TargetRows.stack(target, COLUMNS, samples)
