"""Comparison of the families for every classifier of a model, and the links between the classifiers.

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
from epiprior.ranking.models import calibrate
from epiprior.types import Float32Array, FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.rows import read_rows, voted_rows
from epiprior_lab.params import TrainParams
from epiprior_lab.training.calibration import fit_platt
from epiprior_lab.training.cross_validation import CrossValidation, cross_validate, folds_by_row, folds_by_scene
from epiprior_lab.training.families import FAMILIES, fit, to_onnx
from epiprior_lab.training.samples import Sample, TargetRows

PARITY_ROWS = 2000


@dataclass(frozen=True)
class HeldOut:
    """A classifier, pickled, that was not trained on a scene, and its calibration."""

    classifier: bytes
    platt: tuple[float, float]

    def __call__(self, rows: Float32Array) -> FloatArray:
        """Return calibrated probabilities."""
        return calibrate(pickle.loads(self.classifier).probability(rows), *self.platt)


@dataclass(frozen=True, kw_only=True)
class Refit:
    """The exported family fitted to all rows; before export it gives `parity_rows` the `parity_probability`."""

    onnx: bytes
    importances: FloatArray
    parity_rows: Float32Array
    parity_probability: FloatArray


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All families for one target of one model, which ships the family `exported`.

    `grouped` holds a cross-validation with folds by scene for each family; `ungrouped` that of the exported family with
    folds by row, which shows how much leakage flatters; `refit` the classifier that is exported.
    """

    model: str
    exported: str
    data: TargetRows
    grouped: Mapping[str, CrossValidation]
    ungrouped: CrossValidation
    refit: Refit

    @cached_property
    def platt(self) -> tuple[float, float]:
        """Platt scaling of the exported family, a and b, fitted to its out-of-fold probabilities."""
        return fit_platt(self.grouped[self.exported].probability, self.data.labels)

    def held_out(self, scene: str) -> HeldOut:
        """Return the exported family's classifier of the fold that holds a scene out."""
        found = self.grouped[self.exported]
        folds = found.fold[self.data.scene == scene]
        # A scene without a single row is in no fold: no classifier saw it.
        return HeldOut(found.classifiers[folds[0] if len(folds) else 0], self.platt)


def train(preset: str, folder: Path, params: TrainParams, store: Path) -> list[Comparison]:
    """Train the classifiers of a preset; return their comparisons in the order of `TARGETS`.

    `folder` holds the rows of the training pairs as the stage `features` writes them; `store` is as for `map_tasks`.
    SettingsError if it has no rows.
    """
    files, own = sorted(folder.glob("*.npz")), find_preset(preset)
    if not files:
        raise SettingsError(f"{folder}: no rows; run the stage features first")
    targets = {"two_keypoint": own.two_keypoint_columns, "match": own.match_columns}
    if own.second_round:
        targets["second_round"] = SECOND_ROUND_COLUMNS
    found: list[Comparison] = []
    for target, columns in targets.items():
        tasks: list[Task] = []
        for file in files:
            scene = found[0].data.scenes[len(tasks)] if found else ""
            payload = {
                "file": file,
                "classifiers": tuple(before.held_out(scene) for before in found),
                "most": params.max_rows_per_pair,
                "seed": child_seed(params.seed, "sample", target, file.stem),
            }
            tasks.append(Task(name=f"{preset}-{target}-{file.stem}", payload=payload, files=(file,)))
        samples = map_tasks(draw_sample, tasks, description=f"{preset}: rows of {target}", store=store)
        found.append(compare(preset, TargetRows.stack(target, columns, samples), params, store))
    return found


def draw_sample(*, file: Path, classifiers: Sequence[HeldOut], most: int, seed: int) -> Sample:
    """Draw rows of one pair under one roll hypothesis, for the classifier that follows on `classifiers`.

    Without any these are matches of 2keypoints; else matches, on which the first classifier voted; with two classifiers
    the most probable ones, described for the second round.
    """
    table = read_rows(file)
    if classifiers:
        rows, labels = voted_rows(table, *classifiers)
    else:
        rows = table.two_keypoints.select(find_preset(table.preset).two_keypoint_columns)
        labels = table.two_keypoint_labels
    return Sample.draw(scene=table.scene, pair=file.stem, rows=rows, labels=labels, most=most, seed=seed)


def compare(model: str, data: TargetRows, params: TrainParams, store: Path) -> Comparison:
    """Cross-validate the families on the rows of one target, the exported one by row as well, and refit that one.

    `model` is a preset, or another that `TrainParams.exported` has a family for.
    """
    exported, seed = params.exported[model], child_seed(params.seed, data.target)
    fold_seed = child_seed(seed, "folds")
    by_scene = folds_by_scene(data.labels, data.scene, params.folds, fold_seed)
    by_row = folds_by_row(data.labels, params.folds, fold_seed)
    caps, shared = {"random-forest": params.max_forest_rows, "svm": params.max_svm_rows}, {"data": data, "seed": seed}
    families: list[str] = [family for family in FAMILIES if family in params.families]
    fits = {family: {**shared, "family": family, "max_rows": caps.get(family, params.max_rows)} for family in families}
    planned = {f: {**own, "fold": by_scene, "by_scene": True, "keep": f == exported} for f, own in fits.items()}
    planned["ungrouped"] = {**fits[exported], "fold": by_row, "by_scene": False}
    name, last = f"{model}-{data.target}", f"{model}: {exported}"
    tasks = [Task(name=f"{name}-{key}", payload=payload) for key, payload in planned.items()]
    validated = map_tasks(cross_validate, tasks, description=f"{model}: classifiers of {data.target}", store=store)
    found = dict(zip(planned, validated, strict=True))
    [final] = map_tasks(refit, [Task(name=name, payload=fits[exported])], description=last, store=store)
    ungrouped = found["ungrouped"]
    grouped: dict[str, CrossValidation] = {family: found[family] for family in params.families}
    return Comparison(model=model, exported=exported, data=data, grouped=grouped, ungrouped=ungrouped, refit=final)


def refit(family: str, data: TargetRows, *, seed: int, max_rows: int) -> Refit:
    """Fit the family that is exported to all rows."""
    fitted: Any = fit(family, data.rows, data.labels, seed=child_seed(seed, family, "final"), max_rows=max_rows)
    sample = data.rows[np.linspace(0, len(data.rows) - 1, min(PARITY_ROWS, len(data.rows))).astype(np.int64)]
    return Refit(
        onnx=to_onnx(fitted),
        importances=fitted.importances(),
        parity_rows=sample,
        parity_probability=fitted.probability(sample),
    )
