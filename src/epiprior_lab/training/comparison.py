"""Comparison of the families for both classifiers of every preset, and the link between the two classifiers.

The second classifier learns from the votes of the first. As in later use, the votes of a pair come from a first
classifier that was not trained on the pair's scene.
"""

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior.presets import find_preset
from epiprior.types import Float32Array, FloatArray, IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.rows import match_rows, read_rows
from epiprior_lab.params import TrainParams
from epiprior_lab.training.calibration import Platt, fit_platt
from epiprior_lab.training.cross_validation import CrossValidation, cross_validate, folds_by_row, folds_by_scene
from epiprior_lab.training.families import FAMILIES, fit
from epiprior_lab.training.onnx_graphs import to_onnx
from epiprior_lab.training.samples import Sample, TargetRows

PARITY_ROWS = 2000


@dataclass(frozen=True, kw_only=True)
class Refit:
    """The exported family fitted to all rows; before export it gives `parity_rows` the `parity_probability`."""

    onnx: bytes
    importances: FloatArray | None
    parity_rows: Float32Array
    parity_probability: FloatArray


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All families for one target of one preset, which ships the family `exported`.

    `grouped` holds a cross-validation with folds by scene for each family; `ungrouped` that of the exported family with
    folds by row, which shows how much leakage flatters; `refit` the classifier that is exported.
    """

    preset: str
    exported: str
    data: TargetRows
    grouped: Mapping[str, CrossValidation]
    ungrouped: CrossValidation
    refit: Refit

    @cached_property
    def platt(self) -> Platt:
        """Platt scaling of the exported family, fitted to its out-of-fold probabilities."""
        return fit_platt(self.grouped[self.exported].probability, self.data.labels)


def train(
    folders: Mapping[str, Path], params: TrainParams, *, workers: int, store: Path
) -> dict[str, tuple[Comparison, Comparison]]:
    """Train both classifiers of every preset; return the comparisons for ``two_keypoint`` and ``match`` by preset.

    `folders` holds, by preset, the rows of the training pairs as the stage `features` writes them; `workers` and
    `store` are as for `map_tasks`. SettingsError if a folder has no rows, or a family is unknown.
    """
    unknown = [family for family in params.families if family not in FAMILIES]
    if unknown:
        raise SettingsError(f"train.families: {unknown[0]!r} is unknown, known are {', '.join(FAMILIES)}")
    files = {preset: sorted(folder.glob("*.npz")) for preset, folder in folders.items()}
    for preset, found in files.items():
        if not found:
            raise SettingsError(f"{folders[preset]}: no rows; run the stage features first")
    drawn = {preset: [two_keypoint_sample(file, preset, params) for file in files[preset]] for preset in folders}
    data = {
        preset: TargetRows.stack("two_keypoint", find_preset(preset).two_keypoint_columns, samples)
        for preset, samples in drawn.items()
    }
    first = compare(data, params, workers, store)
    tasks = [task for preset in folders for task in _vote_tasks(files[preset], first[preset], params)]
    samples = iter(map_tasks(match_sample, tasks, workers=workers, description="votes", store=store))
    data = {
        preset: TargetRows.stack("match", find_preset(preset).match_columns, [next(samples) for _ in files[preset]])
        for preset in folders
    }
    second = compare(data, params, workers, store)
    return {preset: (first[preset], second[preset]) for preset in folders}


def two_keypoint_sample(file: Path, preset: str, params: TrainParams) -> Sample:
    """Draw 2keypoint matches of one pair under one roll hypothesis."""
    table = read_rows(file)
    return Sample.draw(
        scene=table.scene,
        pair=file.stem,
        rows=table.two_keypoints.select(find_preset(preset).two_keypoint_columns),
        labels=table.two_keypoint_labels,
        most=params.max_rows_per_pair,
        seed=child_seed(params.seed, "sample", "two_keypoint", file.stem),
    )


def _vote_tasks(files: Sequence[Path], first: Comparison, params: TrainParams) -> list[Task]:
    """Return a task per pair, with the first classifier of the fold that holds out its scene."""
    found = first.grouped[first.exported]
    fold_of_scene = dict(zip(first.data.scene.tolist(), found.fold.tolist(), strict=True))
    shared = {"platt": first.platt, "preset": first.preset, "most": params.max_rows_per_pair}
    tasks = []
    for file, scene in zip(files, first.data.scenes.tolist(), strict=True):
        # A scene without a single 2keypoint match is in no fold: no classifier saw it.
        classifier = found.classifiers[fold_of_scene.get(scene, 0)]
        seed = child_seed(params.seed, "sample", "match", file.stem)
        payload = {"file": file, "classifier": classifier, "seed": seed, **shared}
        tasks.append(Task(name=f"{first.preset}-{file.stem}", payload=payload, files=(file,)))
    return tasks


def match_sample(*, file: Path, classifier: bytes, platt: Platt, preset: str, most: int, seed: int) -> Sample:
    """Let a first classifier vote on one pair under one roll hypothesis, and draw matches."""
    table = read_rows(file)
    descriptors = table.two_keypoints.select(find_preset(preset).two_keypoint_columns)
    rows, labels = match_rows(table, platt(pickle.loads(classifier).probability(descriptors)))
    return Sample.draw(scene=table.scene, pair=file.stem, rows=rows, labels=labels, most=most, seed=seed)


def compare(data: Mapping[str, TargetRows], params: TrainParams, workers: int, store: Path) -> dict[str, Comparison]:
    """Cross-validate the families of every preset, the exported one by row as well, and refit that one.

    `data` are the rows of one target by preset, or by another model that `TrainParams.exported` has a family for.
    """
    store.mkdir(parents=True, exist_ok=True)
    caps = dict.fromkeys(params.families, params.max_rows)
    caps |= {"random-forest": params.max_forest_rows, "svm": params.max_svm_rows}
    exported = {preset: str(getattr(params.exported, preset)) for preset in data}
    plan: dict[tuple[str, str, str], dict[str, Any]] = {}
    for preset, rows in data.items():
        file = store / f"{preset}-{rows.target}-rows.npz"
        rows.save(file)
        seed = child_seed(params.seed, rows.target)
        fold_seed = child_seed(seed, "folds")
        by_scene = folds_by_scene(rows.labels, rows.scene, params.folds, fold_seed)
        for family in params.families:
            own = {"file": file, "family": family, "seed": seed, "max_rows": caps[family]}
            keep = family == exported[preset]
            plan[preset, family, "grouped"] = {**own, "fold": by_scene, "by_scene": True, "keep": keep}
        own = plan[preset, exported[preset], "grouped"]
        by_row = folds_by_row(rows.labels, params.folds, fold_seed)
        plan[preset, exported[preset], "ungrouped"] = {**own, "fold": by_row, "by_scene": False, "keep": False}
        plan[preset, exported[preset], "refit"] = {**own, "fold": None}
    target = next(iter(data.values())).target
    order = sorted(plan, key=lambda key: list(FAMILIES).index(key[1]))
    tasks = [Task(name="-".join((target, *key)), payload=plan[key], files=(plan[key]["file"],)) for key in order]
    results = map_tasks(work, tasks, workers=workers, description=f"classifiers of {target}", store=store)
    found = dict(zip(order, results, strict=True))
    return {
        preset: Comparison(
            preset=preset,
            exported=exported[preset],
            data=rows,
            grouped={family: found[preset, family, "grouped"] for family in params.families},
            ungrouped=found[preset, exported[preset], "ungrouped"],
            refit=found[preset, exported[preset], "refit"],
        )
        for preset, rows in data.items()
    }


def work(
    *, file: Path, family: str, seed: int, max_rows: int, fold: IntArray | None, by_scene: bool, keep: bool
) -> CrossValidation | Refit:
    """Do one task of a comparison: a cross-validation over `fold`, or without it the refit."""
    data = TargetRows.load(file)
    if fold is not None:
        return cross_validate(family, data, fold, by_scene=by_scene, seed=seed, max_rows=max_rows, keep=keep)
    fitted = fit(family, data.rows, data.labels, seed=child_seed(seed, family, "final"), max_rows=max_rows)
    sample = data.rows[np.linspace(0, len(data.rows) - 1, min(PARITY_ROWS, len(data.rows))).astype(np.int64)]
    return Refit(
        onnx=to_onnx(fitted),
        importances=fitted.importances(),
        parity_rows=sample,
        parity_probability=fitted.probability(sample),
    )
