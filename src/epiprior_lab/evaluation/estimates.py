"""Estimators before and after preprocessing, on pairs with control points (paper, "General performance").

Matches are made once per pair (`epiprior_lab.features.matching`); then every estimator runs on its inputs. Each pair
and
estimator is a task of its own, so that a run that was killed continues where it stopped.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.estimators import find_estimator
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from epiprior.types import FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.rankings import calibration_rows, curve_rows, ranked_lists, ranking_rows, roll_rows
from epiprior_lab.features.matching import PRESETS, MatchFiles, PairMatches, store_matches
from epiprior_lab.labels.ground_truth import LabelSettings, errors_px
from epiprior_lab.pairsets import Pair, read_pair_set

Row = dict[str, Any]
HandOvers = Mapping[str, Mapping[str, HandOver]]
EstimatorInputs = Mapping[str, Sequence[str]]


@dataclass(frozen=True, kw_only=True)
class PairEvaluation:
    """Rows of one pair, or of many after `join`; each field becomes one CSV file of the field's name.

    Parameters
    ----------
    results : list of dict
        One row per estimator, input and seed.
    rankings : list of dict
        One row per preset and ranking: size, right matches, precision at 10, 100 and 500, average precision.
    ranking_curves : list of dict
        Right matches among the first `rank`, for ranks on a logarithmic grid.
    roll : list of dict
        Density of the roll between the images.
    calibration : list of dict
        Sums over bins of probability, per preset.
    """

    results: list[Row]
    rankings: list[Row]
    ranking_curves: list[Row]
    roll: list[Row]
    calibration: list[Row]

    @classmethod
    def join(cls, parts: Sequence[PairEvaluation]) -> PairEvaluation:
        """Return the rows of all `parts`, in their order."""
        return cls(**{f.name: [row for part in parts for row in getattr(part, f.name)] for f in fields(cls)})

    def keyed(self, key: Row) -> PairEvaluation:
        """Return the same rows, each led by `key`."""
        return PairEvaluation(**{f.name: [{**key, **row} for row in getattr(self, f.name)] for f in fields(self)})

    def write(self, folder: Path) -> None:
        """Write one CSV file per field to `folder`, made if absent."""
        folder.mkdir(parents=True, exist_ok=True)
        for f in fields(self):
            write_rows(getattr(self, f.name), folder / f"{f.name}.csv")


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """Write rows of equal keys as CSV: seven significant digits, empty cells for NaN and None."""
    import pandas as pd  # slow to load, and workers, which import this module, write nothing

    path.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(path, index=False, float_format="%.7g", lineterminator="\n")


def estimate_row(
    matches: PairMatches,
    points: tuple[FloatArray, FloatArray],
    *,
    estimator: str,
    input_name: str,
    seed: int,
    hand_over: HandOver,
) -> Row:
    """Run one estimator on one input and measure it at the control points.

    Parameters
    ----------
    matches : PairMatches
        As from `match_pair`; of the roll hypotheses the best supported estimate is kept (section 4.7).
    points : tuple of ndarray, shape (N, 2), float64
        Control points in both images, pixels.
    estimator, input_name : str
        What runs on what.
    seed, hand_over
        As for `epiprior.estimators.run.estimate_from_matches`.

    Returns
    -------
    dict
        ``status``, ``support`` out of so many ``matches``, ``spread``, ``plausibility``, ``iterations``,
        ``error_px`` (mean of the roots of the Sampson distances) and ``median_error_px``.

    Notes
    -----
    The errors are those of F before the verdict, NaN only where the estimator gave none. Whether the verdict is right
    is another question (`epiprior_lab.report.verdicts`), and a strict one would flatter the inputs that it spares.
    """
    estimate = estimate_from_matches(
        matches.sets[input_name],
        estimator=estimator,
        seed=seed,
        hand_over=hand_over,
        pixel_factors=matches.pixel_factors,
    )
    distances = np.array([np.nan]) if estimate.raw_F is None else errors_px(estimate.raw_F, *points)
    return {
        "status": str(estimate.status),
        "support": estimate.support,
        "matches": len(estimate.x1),
        "spread": estimate.spread,
        "plausibility": estimate.plausibility,
        "iterations": estimate.iterations,
        "error_px": float(distances.mean()),
        "median_error_px": float(np.median(distances)),
    }


def is_deterministic(estimator: str) -> bool:
    """Return whether the seed changes nothing: one run then stands for all seeds."""
    return bool(getattr(find_estimator(estimator), "deterministic", False))


def estimator_rows(
    *, pair: Pair, matches: MatchFiles, estimator: str, seeds: Sequence[int], hand_overs: Mapping[str, HandOver]
) -> list[Row]:
    """Return one row per input and seed for one estimator.

    Parameters
    ----------
    pair : Pair
        Gives the control points.
    matches : MatchFiles
        The inputs that the estimator gets, in the order of the rows.
    estimator : str
        Name in the registry. A deterministic one runs once, and its row is repeated.
    seeds : sequence of int
        Each becomes a child seed of the pair, the same for every input, so that differences are paired.
    hand_overs : mapping of str to HandOver
        Per input.
    """
    points = pair.control_points()
    sets = matches.read()
    different = seeds[:1] if is_deterministic(estimator) else seeds
    rows = []
    for name in sets.sets:
        found = [
            estimate_row(
                sets,
                points,
                estimator=estimator,
                input_name=name,
                seed=child_seed(seed, pair.pair_id),
                hand_over=hand_overs[name],
            )
            for seed in different
        ]
        rows += [
            {"estimator": estimator, "input": name, "seed": seed, **found[min(k, len(found) - 1)]}
            for k, seed in enumerate(seeds)
        ]
    return rows


def evaluate_rankings(*, pair: Pair, matches: MatchFiles, labels: LabelSettings) -> PairEvaluation:
    """Evaluate what comes before the estimators: rankings, roll densities and calibration of one pair.

    Parameters
    ----------
    pair : Pair
        Pair with cameras, depths or control points by which matches are labelled.
    matches : MatchFiles
        The presets.
    labels : LabelSettings
        When a match counts as right.
    """
    sets = matches.read().sets
    rankings, curves, calibration = [], [], []
    for preset in sets:
        # The first set belongs to the expected roll; the second, if any, to none.
        ranked = sets[preset][0]
        lists = ranked_lists(pair, ranked, labels)
        rankings += [{"preset": preset, **row} for row in ranking_rows(lists)]
        curves += [{"preset": preset, **row} for row in curve_rows(lists)]
        calibration += [{"preset": preset, **row} for row in calibration_rows(ranked, lists["final"])]
    roll = roll_rows(pair, sets["default"][0]) if "default" in sets else []
    return PairEvaluation(results=[], rankings=rankings, ranking_curves=curves, roll=roll, calibration=calibration)


def evaluate_pairs(
    pairs: Sequence[Pair],
    *,
    family: str,
    inputs: EstimatorInputs,
    seeds: Sequence[int],
    hand_overs: HandOvers,
    labels: LabelSettings,
    files: Sequence[Path] = (),
    workers: int = 1,
    store: Path | None = None,
) -> PairEvaluation:
    """Evaluate many pairs in parallel; a run that was killed continues.

    Parameters
    ----------
    pairs : sequence of Pair
        Pairs of one set.
    family : str
        Name of the pair set; it leads every row, followed by pair id and scene.
    inputs : mapping of str to sequence of str
        For each estimator the inputs that it gets, out of `matching.INPUTS`.
    seeds, hand_overs, labels
        As for `estimator_rows` (with the estimator first: ``hand_overs[estimator][input]``) and
        `evaluate_rankings`.
    files : sequence of Path
        What decides every pair beside its own images: the model files.
    workers, store
        As for `epiprior_lab.compute.tasks.map_tasks`.
    """
    used = [name for names in inputs.values() for name in names]
    presets = [name for name in PRESETS if name in used]
    with match_folder(store) as folder:
        matched = store_matches(
            pairs, tuple(dict.fromkeys(used)), folder, files=files, workers=workers,
            description=f"match {family}", resume=store is not None,
        )  # fmt: skip
        ranked = map_tasks(
            evaluate_rankings,
            [
                _task(pair.pair_id, pair, matches.only(presets), {"labels": labels})
                for pair, matches in zip(pairs, matched, strict=True)
            ],
            workers=workers,
            description=f"rankings of {family}",
            store=store,
        )
        results = map_tasks(
            estimator_rows,
            [
                _task(
                    f"{pair.pair_id} {estimator}",
                    pair,
                    matches.only(names),
                    {
                        "estimator": estimator,
                        "seeds": tuple(seeds),
                        "hand_overs": {name: hand_overs[estimator][name] for name in names},
                    },
                )
                for pair, matches in zip(pairs, matched, strict=True)
                for estimator, names in inputs.items()
            ],
            workers=workers,
            description=f"estimate {family}",
            store=store,
        )
    parts = []
    for k, pair in enumerate(pairs):
        own = results[k * len(inputs) : (k + 1) * len(inputs)]
        whole = PairEvaluation.join([_only_results(rows) for rows in own] + [ranked[k]])
        parts.append(whole.keyed({"family": family, "pair_id": pair.pair_id, "scene": pair.scene}))
    return PairEvaluation.join(parts)


def _task(name: str, pair: Pair, matches: MatchFiles, settings: Row) -> Task:
    files = (*pair.files, *matches.paths.values())
    return Task(name=name, payload={"pair": pair, "matches": matches, **settings}, files=files)


def _only_results(rows: list[Row]) -> PairEvaluation:
    return PairEvaluation(results=rows, rankings=[], ranking_curves=[], roll=[], calibration=[])


@contextmanager
def match_folder(store: Path | None) -> Iterator[Path]:
    """Yield a folder for matches: beside the stored results, or for this run alone."""
    if store is not None:
        yield store / "matches"
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def study_pairs(split: str, family: str, data: Path = Path("data")) -> tuple[Pair, ...]:
    """Return the rendered pairs of one family and split, with their control points."""
    control_points = data / "ground_truth" / split / family / "control_points"
    return read_pair_set(data / "scenes" / split / family, control_points).pairs
