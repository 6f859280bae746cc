"""Training of a preset's two classifiers: rows, comparison of families, and the link between the two.

The second classifier learns from votes, and votes come from the first. So that it meets in training what it
will meet in use, the votes of a pair come from a first classifier that never saw the pair's scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior.presets import find_preset
from epiprior.types import IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.rows import match_columns, match_rows, read_rows
from epiprior_lab.params import TrainParams
from epiprior_lab.training.calibration import Platt
from epiprior_lab.training.classifiers import Comparison, Sample, TargetRows, compare_families, rows_file
from epiprior_lab.training.cross_validation import fit_without
from epiprior_lab.training.families import FAMILIES


@dataclass(frozen=True, kw_only=True)
class PresetTraining:
    """What came of training for one preset.

    Parameters
    ----------
    family : str
        Name of the exported family.
    two_keypoint, match : Comparison
        All families for each target.
    """

    family: str
    two_keypoint: Comparison
    match: Comparison

    @property
    def comparisons(self) -> tuple[Comparison, Comparison]:
        """Both."""
        return self.two_keypoint, self.match


def train_preset(folder: Path, preset: str, params: TrainParams, *, workers: int, store: Path) -> PresetTraining:
    """Train both classifiers of a preset.

    Parameters
    ----------
    folder : Path
        Rows of the training pairs, as the stage `features` writes them.
    preset : str
        Name of the preset.
    params : TrainParams
        Seeds, folds, families and caps.
    workers : int
        Processes.
    store : Path
        Folder of intermediate results.

    Returns
    -------
    PresetTraining
        The same whatever the number of workers, times aside.

    Raises
    ------
    SettingsError
        If there are no rows in the folder, or a family is unknown.
    """
    unknown = [family for family in params.families if family not in FAMILIES]
    if unknown:
        raise SettingsError(f"train.families: {unknown[0]!r} is unknown, known are {', '.join(FAMILIES)}")
    files = sorted(folder.glob("*.npz"))
    if not files:
        raise SettingsError(f"{folder}: no rows; run the stage features first")
    exported = str(getattr(params.exported, preset))
    caps = dict.fromkeys(params.families, params.max_rows)
    caps |= {"random-forest": params.max_forest_rows, "svm": params.max_svm_rows}
    shared = {"preset": preset, "seed": params.seed, "most": params.max_rows_per_pair}

    samples = map_tasks(
        two_keypoint_sample,
        [Task(name=file.stem, payload={"file": file, **shared}, files=(file,)) for file in files],
        workers=workers,
        description=f"2keypoint matches, preset {preset}",
        store=store,
    )
    columns = find_preset(preset).two_keypoint_columns
    data = TargetRows.stack("two_keypoint", columns, samples)
    first = _compare(data, params, exported, caps, workers, store)
    settings = {**shared, "family": exported, "max_rows": caps[exported]}
    found = map_tasks(
        match_samples,
        _match_tasks(files, samples, first, settings, store),
        workers=workers,
        description=f"votes, preset {preset}",
        store=store,
    )
    by_pair = {sample.pair: sample for fold in found for sample in fold}
    data = TargetRows.stack("match", match_columns(preset), [by_pair[sample.pair] for sample in samples])
    second = _compare(data, params, exported, caps, workers, store)
    return PresetTraining(family=exported, two_keypoint=first, match=second)


def _compare(
    data: TargetRows, params: TrainParams, exported: str, caps: Mapping[str, int], workers: int, store: Path
) -> Comparison:
    return compare_families(
        data,
        families=params.families,
        exported=exported,
        folds=params.folds,
        seed=child_seed(params.seed, data.target),
        max_rows=caps,
        workers=workers,
        store=store,
    )


def two_keypoint_sample(*, file: Path, preset: str, seed: int, most: int) -> Sample:
    """Draw 2keypoint matches of one pair under one roll hypothesis."""
    table = read_rows(file)
    rows = table.two_keypoints.select(find_preset(preset).two_keypoint_columns)
    return Sample.draw(
        scene=table.scene,
        pair=file.stem,
        rows=rows,
        labels=table.two_keypoint_labels,
        most=most,
        seed=child_seed(seed, "sample", "two_keypoint", file.stem),
    )


def _match_tasks(
    files: Sequence[Path], samples: Sequence[Sample], first: Comparison, settings: dict[str, Any], store: Path
) -> list[Task]:
    """Return one task per fold of the first classifier, for the pairs that it holds out."""
    fold = first.grouped[settings["family"]].fold
    fold_of_scene = dict(zip(first.data.scene.tolist(), fold.tolist(), strict=True))
    rows = rows_file(store, first.data.target)
    shared = {
        **settings,
        "rows": rows,
        "fold": fold,
        "fit_seed": child_seed(settings["seed"], first.data.target),
        "platt": first.calibration(settings["family"]),
    }
    tasks = []
    for number in range(int(fold.max()) + 1):
        # A scene without a single 2keypoint match is in no fold: every classifier is out of its folds.
        held = [
            file for file, sample in zip(files, samples, strict=True) if fold_of_scene.get(sample.scene, 0) == number
        ]
        payload = {**shared, "files": held, "number": number}
        tasks.append(Task(name=f"fold-{number}", payload=payload, files=(rows, *held)))
    return tasks


def match_samples(
    *,
    files: Sequence[Path],
    rows: Path,
    family: str,
    fold: IntArray,
    number: int,
    max_rows: int,
    fit_seed: int,
    platt: Platt,
    preset: str,
    seed: int,
    most: int,
) -> list[Sample]:
    """Let the first classifier without a fold vote on the pairs of the fold, and draw matches of each."""
    with np.load(rows, allow_pickle=False) as stored:
        X, y = stored["rows"], stored["labels"]
    first = fit_without(family, X, y, fold == number, number, seed=fit_seed, max_rows=max_rows)
    columns = find_preset(preset).two_keypoint_columns
    drawn = []
    for file in files:
        table = read_rows(file)
        probability = platt(first.probability(table.two_keypoints.select(columns)))
        kpmd, labels = match_rows(table, probability)
        drawn.append(
            Sample.draw(
                scene=table.scene,
                pair=file.stem,
                rows=kpmd,
                labels=labels,
                most=most,
                seed=child_seed(seed, "sample", "match", file.stem),
            )
        )
    return drawn
