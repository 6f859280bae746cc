"""Comparison of the families for every classifier of every preset, and the links between the classifiers.

The second classifier learns from the votes of the first, the third from the probabilities of the second. As in later
use, the votes and probabilities of a pair come from classifiers that were not trained on the pair's scene.
"""

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior.presets import SECOND_ROUND_COLUMNS, find_preset
from epiprior.types import Float32Array, FloatArray, IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.rows import match_rows, read_rows, second_round_sample
from epiprior_lab.params import TrainParams
from epiprior_lab.training.calibration import Platt, fit_platt
from epiprior_lab.training.cross_validation import CrossValidation, cross_validate, folds_by_row, folds_by_scene
from epiprior_lab.training.families import FAMILIES, fit
from epiprior_lab.training.onnx_graphs import to_onnx
from epiprior_lab.training.samples import Sample, TargetRows

PARITY_ROWS = 2000
Before = dict[str, "Comparison"]  # by preset


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
) -> dict[str, tuple[Comparison, ...]]:
    """Train the classifiers of every preset; return the comparisons by preset, in the order of `TARGETS`.

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

    def voted(target: str, columns: Mapping[str, tuple[str, ...]], description: str, *before: Before) -> Before:
        tasks = [t for name in columns for t in _vote_tasks(files[name], params, *(found[name] for found in before))]
        samples = iter(map_tasks(voted_sample, tasks, workers=workers, description=description, store=store))
        data = {n: TargetRows.stack(target, own, [next(samples) for _ in files[n]]) for n, own in columns.items()}
        return compare(data, params, workers, store) if data else {}

    presets = {name: find_preset(name) for name in folders}
    drawn = {name: [two_keypoint_sample(file, name, params) for file in files[name]] for name in folders}
    data = {n: TargetRows.stack("two_keypoint", presets[n].two_keypoint_columns, own) for n, own in drawn.items()}
    first = compare(data, params, workers, store)
    second = voted("match", {name: preset.match_columns for name, preset in presets.items()}, "votes", first)
    again = {name: SECOND_ROUND_COLUMNS for name, preset in presets.items() if preset.second_round}
    third = voted("second_round", again, "second round", first, second)
    return {name: tuple(found[name] for found in (first, second, third) if name in found) for name in folders}


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


@dataclass(frozen=True)
class HeldOut:
    """A classifier, pickled, that was not trained on a scene, and its calibration."""

    classifier: bytes
    platt: Platt

    def __call__(self, rows: Float32Array) -> FloatArray:
        """Return calibrated probabilities."""
        return self.platt(pickle.loads(self.classifier).probability(rows))


def _held_out(comparison: Comparison) -> dict[str, HeldOut]:
    """Return by scene the exported family's classifier of the fold that holds it out."""
    found = comparison.grouped[comparison.exported]
    fold_of_scene = dict(zip(comparison.data.scene.tolist(), found.fold.tolist(), strict=True))
    return {
        # A scene without a single row is in no fold: no classifier saw it.
        scene: HeldOut(found.classifiers[fold_of_scene.get(scene, 0)], comparison.platt)
        for scene in comparison.data.scenes.tolist()
    }


def _vote_tasks(files: Sequence[Path], params: TrainParams, *before: Comparison) -> list[Task]:
    """Return a task per pair, with the classifiers that hold out its scene: the first, or the first and the second."""
    held, first = [_held_out(comparison) for comparison in before], before[0]
    tasks, target = [], "second_round" if len(before) > 1 else "match"
    for file, scene in zip(files, first.data.scenes.tolist(), strict=True):
        payload = {
            "file": file,
            "classifiers": tuple(of_scene[scene] for of_scene in held),
            "most": params.max_rows_per_pair,
            "seed": child_seed(params.seed, "sample", target, file.stem),
        }
        tasks.append(Task(name=f"{first.preset}-{target}-{file.stem}", payload=payload, files=(file,)))
    return tasks


def voted_sample(*, file: Path, classifiers: tuple[HeldOut, ...], most: int, seed: int) -> Sample:
    """Let the first classifier vote on one pair under one roll hypothesis, and draw matches.

    With a second classifier these are the most probable matches, described for the second round.
    """
    table = read_rows(file)
    probability = classifiers[0](table.two_keypoints.select(find_preset(table.preset).two_keypoint_columns))
    if len(classifiers) > 1:
        rows, labels = second_round_sample(table, probability, classifiers[1])
    else:
        rows, labels = match_rows(table, probability)
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
