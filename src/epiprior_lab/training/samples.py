"""Rows that classifiers are trained on and compared by: a random sample of every pair's."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Labelled rows, shape (M, C), of a pair under one roll hypothesis (`pair` names both), drawn from `size` rows."""

    scene: str
    pair: str
    rows: Float32Array
    labels: BoolArray
    size: int

    @classmethod
    def draw(cls, *, scene: str, pair: str, rows: Float32Array, labels: BoolArray, most: int, seed: int) -> Sample:
        """Keep `most` rows at most, in their order."""
        size = len(rows)
        kept = np.arange(size)
        if size > most:
            kept = np.sort(np.random.default_rng(seed).choice(size, most, replace=False))
        return cls(scene=scene, pair=pair, rows=rows[kept], labels=labels[kept], size=size)


@dataclass(frozen=True, kw_only=True)
class TargetRows:
    """Rows of all pairs for one target, ``two_keypoint`` or ``match``; those of a pair one after the other.

    `rows`, shape (N, C), and `labels`, shape (N,), are of all pairs; `scenes`, `pairs`, `lengths` and `share`, shape
    (P,), of each pair under one roll hypothesis: scene, name, number of rows, and which share of its rows that is.
    """

    target: str
    columns: tuple[str, ...]
    rows: Float32Array
    labels: BoolArray
    scenes: NDArray[np.str_]
    pairs: NDArray[np.str_]
    lengths: IntArray
    share: FloatArray

    @classmethod
    def stack(cls, target: str, columns: tuple[str, ...], samples: Sequence[Sample]) -> TargetRows:
        """Put samples of different pairs together."""
        return cls(
            target=target,
            columns=columns,
            rows=np.concatenate([sample.rows for sample in samples]),
            labels=np.concatenate([sample.labels for sample in samples]),
            scenes=np.array([sample.scene for sample in samples]),
            pairs=np.array([sample.pair for sample in samples]),
            lengths=np.array([len(sample.rows) for sample in samples]),
            share=np.array([len(sample.rows) / max(1, sample.size) for sample in samples]),
        )

    @property
    def slices(self) -> list[slice]:
        """Rows of each pair."""
        ends = np.cumsum(self.lengths)
        return [slice(start, end) for start, end in zip(ends - self.lengths, ends, strict=True)]

    @property
    def scene(self) -> NDArray[np.str_]:
        """Scene of each row, shape (N,)."""
        return np.repeat(self.scenes, self.lengths)

    def digest(self) -> str:
        """Return the sha256 of names, rows, labels, scenes and pairs."""
        digest = hashlib.sha256("\0".join((self.target, *self.columns)).encode())
        for array in (self.rows, self.labels, self.scene, np.repeat(self.pairs, self.lengths)):
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()
