"""All families of classifiers for one target, side by side: cross-validations and refits."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.export.onnx_files import to_onnx
from epiprior_lab.training.calibration import Platt, fit_platt
from epiprior_lab.training.cross_validation import CrossValidation, cross_validate, fit_final

PARITY_ROWS = 2000
# The slowest first: the last task to end decides how long all take.
_SLOWEST_FIRST = ("random-forest", "svm", "lightgbm", "tree")


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Rows of one pair under one roll hypothesis, drawn at random from `size` rows.

    Parameters
    ----------
    scene, pair : str
        Names; `pair` says the hypothesis as well.
    rows : ndarray, shape (M, C), float32
        Descriptors.
    labels : ndarray, shape (M,), bool
        Which are right.
    size : int
        Rows that there are.
    """

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
    """Rows of all pairs for one target.

    Parameters
    ----------
    target : str
        ``two_keypoint`` or ``match``.
    columns : tuple of str
        Names of the C columns.
    rows : ndarray, shape (N, C), float32
        Descriptors.
    labels : ndarray, shape (N,), bool
        Which are right.
    scene, pair : ndarray, shape (N,), str
        Scene of each row, and the pair and roll hypothesis in which it is ranked.
    share : mapping of str to float
        For each pair, the share of its rows that are here: a random sample.
    """

    target: str
    columns: tuple[str, ...]
    rows: Float32Array
    labels: BoolArray
    scene: NDArray[np.str_]
    pair: NDArray[np.str_]
    share: Mapping[str, float]

    @classmethod
    def stack(cls, target: str, columns: tuple[str, ...], samples: Sequence[Sample]) -> TargetRows:
        """Put samples of different pairs together."""
        lengths = [len(sample.rows) for sample in samples]
        return cls(
            target=target,
            columns=columns,
            rows=np.concatenate([sample.rows for sample in samples]),
            labels=np.concatenate([sample.labels for sample in samples]),
            scene=np.repeat([sample.scene for sample in samples], lengths),
            pair=np.repeat([sample.pair for sample in samples], lengths),
            share={sample.pair: len(sample.rows) / max(1, sample.size) for sample in samples},
        )

    def digest(self) -> str:
        """Return the sha256 of everything in it."""
        digest = hashlib.sha256("\0".join((self.target, *self.columns)).encode())
        for array in (self.rows, self.labels, self.scene, self.pair):
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Refit:
    """A family refitted on all rows.

    Parameters
    ----------
    onnx : bytes
        Its graph.
    importances : ndarray, shape (C,), float64, or None
        Share of each column in the decisions.
    parity_rows : ndarray, shape (M, C), float32
        Some of the rows,
    parity_probability : ndarray, shape (M,), float64
        and what the classifier itself says of them, before export.
    """

    onnx: bytes
    importances: FloatArray | None
    parity_rows: Float32Array
    parity_probability: FloatArray


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What came of all families for one target.

    Parameters
    ----------
    data : TargetRows
        The rows.
    grouped : mapping of str to CrossValidation
        By family.
    ungrouped : mapping of str to CrossValidation
        Of the exported family alone: how much leakage flatters is shown by one.
    refits : mapping of str to Refit
        By family.
    """

    data: TargetRows
    grouped: Mapping[str, CrossValidation]
    ungrouped: Mapping[str, CrossValidation]
    refits: Mapping[str, Refit]

    def calibration(self, family: str) -> Platt:
        """Return Platt scaling fitted on the family's out-of-fold probabilities."""
        return fit_platt(self.grouped[family].probability, self.data.labels)


def rows_file(store: Path, target: str) -> Path:
    """Return where `compare_families` puts the rows, for its tasks to read."""
    return store / f"{target}-rows.npz"


def compare_families(
    data: TargetRows,
    *,
    families: Sequence[str],
    exported: str,
    folds: int,
    seed: int,
    max_rows: Mapping[str, int],
    workers: int,
    store: Path,
) -> Comparison:
    """Cross-validate all families grouped, the exported one ungrouped as well, and refit them, in parallel.

    Parameters
    ----------
    data : TargetRows
        The rows.
    families : sequence of str
        Names in `families.FAMILIES`.
    exported : str
        The one of them that is exported.
    folds, seed : int
        See `cross_validate`.
    max_rows : mapping of str to int
        Cap of the rows that each family trains on.
    workers : int
        Processes.
    store : Path
        Folder of intermediate results, so that a killed run resumes.

    Returns
    -------
    Comparison
        The same whatever the number of workers, times aside.
    """
    store.mkdir(parents=True, exist_ok=True)
    file = rows_file(store, data.target)
    np.savez(file, rows=data.rows, labels=data.labels, scene=data.scene, pair=data.pair)
    settings = {"file": file, "columns": data.columns, "share": data.share, "folds": folds, "seed": seed}
    order = sorted(families, key=_SLOWEST_FIRST.index)
    planned = [
        (family, kind)
        for family in order
        for kind in ("grouped", "ungrouped", "refit")
        if kind != "ungrouped" or family == exported
    ]
    tasks = [
        Task(
            name=f"{data.target}-{family}-{kind}",
            payload={**settings, "family": family, "kind": kind, "max_rows": max_rows[family]},
            files=(file,),
        )
        for family, kind in planned
    ]
    description = f"classifiers of {data.target}"
    results = map_tasks(work, tasks, workers=workers, description=description, store=store)
    found: dict[str, dict[str, Any]] = {"grouped": {}, "ungrouped": {}, "refit": {}}
    for (family, kind), result in zip(planned, results, strict=True):
        found[kind][family] = result
    return Comparison(data=data, grouped=found["grouped"], ungrouped=found["ungrouped"], refits=found["refit"])


def work(
    *,
    file: Path,
    columns: tuple[str, ...],
    share: Mapping[str, float],
    family: str,
    kind: str,
    folds: int,
    seed: int,
    max_rows: int,
) -> CrossValidation | Refit:
    """Do one task of `compare_families`."""
    with np.load(file, allow_pickle=False) as stored:
        rows, labels, scene, pair = (stored[name] for name in ("rows", "labels", "scene", "pair"))
    if kind == "refit":
        fitted = fit_final(family, rows, labels, seed=seed, max_rows=max_rows)
        sample = rows[np.linspace(0, len(rows) - 1, min(PARITY_ROWS, len(rows))).astype(np.int64)]
        return Refit(
            onnx=to_onnx(fitted),
            importances=fitted.importances(),
            parity_rows=sample,
            parity_probability=fitted.probability(sample),
        )
    return cross_validate(
        family,
        rows,
        labels,
        scene,
        pair,
        columns=columns,
        folds=folds,
        seed=seed,
        grouped=kind == "grouped",
        max_rows=max_rows,
        share=share,
    )
