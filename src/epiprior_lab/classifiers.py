"""All families of classifiers for one target, side by side: cross-validations and refits."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.calibration import Platt, cross_calibrate, fit_platt
from epiprior_lab.export import to_onnx
from epiprior_lab.metrics import ranking_metrics, row_metrics
from epiprior_lab.parallel import Task, map_tasks
from epiprior_lab.training import CrossValidation, cross_validate, fit_final

PARITY_ROWS = 2000
# The slowest first: the last task to end decides how long all take.
_SLOWEST_FIRST = ("random-forest", "svm", "lightgbm", "tree")


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
    """

    target: str
    columns: tuple[str, ...]
    rows: Float32Array
    labels: BoolArray
    scene: NDArray[np.str_]
    pair: NDArray[np.str_]

    @classmethod
    def stack(
        cls,
        target: str,
        columns: tuple[str, ...],
        parts: Iterable[tuple[Float32Array, BoolArray, str, str]],
    ) -> TargetRows:
        """Put together (rows, labels, scene, pair) of one pair after the other."""
        rows, labels, scene, pair = zip(*parts, strict=True)
        lengths = [len(part) for part in rows]
        return cls(
            target=target,
            columns=columns,
            rows=np.concatenate(rows),
            labels=np.concatenate(labels),
            scene=np.repeat(np.array(scene), lengths),
            pair=np.repeat(np.array(pair), lengths),
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
    grouped, ungrouped : mapping of str to CrossValidation
        By family.
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

    def calibrated_metrics(self, family: str) -> dict[str, float]:
        """Return the metrics of out-of-fold probabilities, each calibrated on the other folds."""
        item = self.grouped[family]
        probability = cross_calibrate(item.probability, self.data.labels, item.fold)
        ranking = ranking_metrics(probability, self.data.labels, self.data.pair)
        return ranking | row_metrics(probability, self.data.labels)


def compare_families(
    data: TargetRows,
    *,
    families: Sequence[str],
    folds: int,
    seed: int,
    max_rows: Mapping[str, int],
    workers: int,
    store: Path,
) -> Comparison:
    """Cross-validate all families, grouped and ungrouped, and refit them, in parallel.

    Parameters
    ----------
    data : TargetRows
        The rows.
    families : sequence of str
        Names in `families.FAMILIES`.
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
    file = store / f"{data.target}-rows.npz"
    np.savez(file, rows=data.rows, labels=data.labels, scene=data.scene, pair=data.pair)
    settings = {"file": file, "columns": data.columns, "folds": folds, "seed": seed}
    order = sorted(families, key=_SLOWEST_FIRST.index)
    tasks = [
        Task(
            name=f"{data.target}-{family}-{kind}",
            payload={**settings, "family": family, "kind": kind, "max_rows": max_rows[family]},
            files=(file,),
        )
        for family in order
        for kind in ("grouped", "ungrouped", "refit")
    ]
    description = f"classifiers of {data.target}"
    results = iter(map_tasks(work, tasks, workers=workers, description=description, store=store))
    found: dict[str, dict[str, Any]] = {"grouped": {}, "ungrouped": {}, "refit": {}}
    for family in order:
        for by_family in found.values():
            by_family[family] = next(results)
    return Comparison(
        data=data, grouped=found["grouped"], ungrouped=found["ungrouped"], refits=found["refit"]
    )


def work(
    *, file: Path, columns: tuple[str, ...], family: str, kind: str, folds: int, seed: int, max_rows: int
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
    )
