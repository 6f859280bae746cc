"""Estimators before and after preprocessing, on pairs with control points (paper, "General performance").

A pair is ranked once per preset; every estimator then runs on the same four inputs:

``standard``
    X_L of the paper: nearest neighbours of plain SIFT by distance ratio.
``snn``
    RootSIFT, mutual nearest neighbours, ratio below 0.85: the strongest simple pipeline of today.
``paper``, ``default``
    The ranked matches of the preset, one set per roll hypothesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.baselines import snn_matches, standard_matches
from epiprior.errors import SettingsError
from epiprior.estimate import estimate_from_matches
from epiprior.features import FeatureSettings, detect_features, load_photograph
from epiprior.handover import HandOver
from epiprior.preprocess import rank_matches
from epiprior.types import FloatArray, MatchSet
from epiprior_lab.datasets import Pair, read_pair_set
from epiprior_lab.ground_truth import LabelSettings, errors_px
from epiprior_lab.parallel import Task, map_tasks
from epiprior_lab.rankings import calibration_rows, curve_rows, ranked_lists, ranking_rows, roll_rows
from epiprior_lab.seeds import child_seed

Row = dict[str, Any]
HandOvers = Mapping[str, Mapping[str, HandOver]]

BASELINES = ("standard", "snn")
PRESETS = ("paper", "default")
INPUTS = BASELINES + PRESETS


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

    def write(self, folder: Path) -> None:
        """Write one CSV file per field to `folder`, made if absent."""
        folder.mkdir(parents=True, exist_ok=True)
        for f in fields(self):
            write_rows(getattr(self, f.name), folder / f"{f.name}.csv")


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """Write rows of equal keys as CSV: seven significant digits, empty cells for NaN and None."""
    path.parent.mkdir(parents=True, exist_ok=True)
    frame = pd.DataFrame(rows)
    frame.to_csv(path, index=False, float_format="%.7g", lineterminator="\n")


@dataclass(frozen=True, kw_only=True)
class PairMatches:
    """The matches of one pair, made in several ways.

    Parameters
    ----------
    sets : dict of str to tuple of MatchSet
        Per input; baselines have one set, presets one per roll hypothesis.
    pixel_factors : tuple of float
        Given pixels per working pixel in both images, as `estimate_from_matches` wants them.
    """

    sets: dict[str, tuple[MatchSet, ...]]
    pixel_factors: tuple[float, float]


def match_pair(pair: Pair, inputs: Sequence[str]) -> PairMatches:
    """Match one pair in every asked way.

    Parameters
    ----------
    pair : Pair
        Its two images are read.
    inputs : sequence of str
        Names out of `INPUTS`.

    Returns
    -------
    PairMatches
        Inputs in the order that was asked for.

    Raises
    ------
    SettingsError
        If an input is unknown.
    """
    unknown = [name for name in inputs if name not in INPUTS]
    if unknown:
        raise SettingsError(f"input is {unknown[0]!r}, known: {', '.join(INPUTS)}")
    sets: dict[str, tuple[MatchSet, ...]] = {}
    settings = FeatureSettings()
    photographs = [load_photograph(image, settings.max_image_size) for image in (pair.image1, pair.image2)]
    first, second = (detect_features(photograph, settings) for photograph in photographs)
    for name in inputs:
        if name == "standard":
            sets[name] = (standard_matches(pair.image1, pair.image2),)
        elif name == "snn":
            sets[name] = (snn_matches(pair.image1, pair.image2),)
        else:
            # Presets differ in how descriptors are normalised, not in what is detected.
            ranked = rank_matches(pair.image1, pair.image2, preset=name, features1=first, features2=second)
            sets[name] = ranked.sets
    return PairMatches(sets=sets, pixel_factors=(photographs[0].factor, photographs[1].factor))


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
        As for `epiprior.estimate.estimate_from_matches`.

    Returns
    -------
    dict
        ``status``, ``support``, ``iterations``, ``error_px`` (mean of the roots of the Sampson distances) and
        ``median_error_px``; the two errors are NaN without a fundamental matrix.
    """
    estimate = estimate_from_matches(
        matches.sets[input_name],
        estimator=estimator,
        seed=seed,
        hand_over=hand_over,
        pixel_factors=matches.pixel_factors,
    )
    distances = np.array([np.nan]) if estimate.F is None else errors_px(estimate.F, *points)
    return {
        "status": str(estimate.status),
        "support": estimate.support,
        "iterations": estimate.iterations,
        "error_px": float(distances.mean()),
        "median_error_px": float(np.median(distances)),
    }


def result_rows(
    pair: Pair,
    matches: PairMatches,
    *,
    estimators: Sequence[str],
    seeds: Sequence[int],
    hand_overs: HandOvers,
) -> list[Row]:
    """Return one row per estimator, input and seed.

    Parameters
    ----------
    pair : Pair
        Gives the control points.
    matches : PairMatches
        As from `match_pair`.
    estimators : sequence of str
        Names in the registry.
    seeds : sequence of int
        Each becomes a child seed of the pair, the same for every input, so that differences are paired.
    hand_overs : mapping
        ``hand_overs[estimator][input]``.
    """
    points = pair.control_points()
    rows = []
    for estimator in estimators:
        for name in matches.sets:
            for seed in seeds:
                row = estimate_row(
                    matches,
                    points,
                    estimator=estimator,
                    input_name=name,
                    seed=child_seed(seed, pair.pair_id),
                    hand_over=hand_overs[estimator][name],
                )
                rows.append({"estimator": estimator, "input": name, "seed": seed, **row})
    return rows


def evaluate_pair(
    *,
    pair: Pair,
    family: str,
    estimators: Sequence[str],
    inputs: Sequence[str],
    seeds: Sequence[int],
    hand_overs: HandOvers,
    labels: LabelSettings,
) -> PairEvaluation:
    """Evaluate one pair: estimates, rankings, roll densities and calibration.

    Parameters
    ----------
    pair : Pair
        Pair with control points, and cameras or depths by which matches are labelled.
    family : str
        Name of the pair set; it leads every row, followed by pair id and scene.
    estimators, inputs, seeds, hand_overs
        As for `result_rows` and `match_pair`.
    labels : LabelSettings
        When a match counts as right in rankings and calibration.
    """
    matches = match_pair(pair, inputs)
    key = {"family": family, "pair_id": pair.pair_id, "scene": pair.scene}
    rankings, curves, calibration = [], [], []
    for preset in (name for name in inputs if name in PRESETS):
        # The first set belongs to the expected roll; the second, if any, to none.
        ranked = matches.sets[preset][0]
        lists = ranked_lists(pair, ranked, labels)
        rankings += [{**key, "preset": preset, **row} for row in ranking_rows(lists)]
        curves += [{**key, "preset": preset, **row} for row in curve_rows(lists)]
        calibration += [{**key, "preset": preset, **row} for row in calibration_rows(ranked, lists["final"])]
    results = result_rows(pair, matches, estimators=estimators, seeds=seeds, hand_overs=hand_overs)
    roll = roll_rows(pair, matches.sets["default"][0]) if "default" in matches.sets else []
    return PairEvaluation(
        results=[{**key, **row} for row in results],
        rankings=rankings,
        ranking_curves=curves,
        roll=[{**key, **row} for row in roll],
        calibration=calibration,
    )


def evaluate_pairs(
    pairs: Sequence[Pair],
    *,
    family: str,
    estimators: Sequence[str],
    inputs: Sequence[str],
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
    family, estimators, inputs, seeds, hand_overs, labels
        As for `evaluate_pair`.
    files : sequence of Path
        What decides every pair beside its own images: the model files.
    workers, store
        As for `epiprior_lab.parallel.map_tasks`.
    """
    settings = {
        "family": family,
        "estimators": tuple(estimators),
        "inputs": tuple(inputs),
        "seeds": tuple(seeds),
        "hand_overs": {e: dict(hand_overs[e]) for e in estimators},
        "labels": labels,
    }
    tasks = [Task(name=pair.pair_id, payload={"pair": pair, **settings}, files=(*pair.files, *files)) for pair in pairs]
    description = f"evaluate {family}"
    parts = map_tasks(evaluate_pair, tasks, workers=workers, description=description, store=store)
    return PairEvaluation.join(parts)


def study_pairs(split: str, family: str, data: Path = Path("data")) -> tuple[Pair, ...]:
    """Return the rendered pairs of one family and split, with their control points."""
    control_points = data / "ground_truth" / split / family / "control_points"
    return read_pair_set(data / "scenes" / split / family, control_points).pairs


def model_files(models: Path, inputs: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of the models that the inputs need, sorted: they decide the matches."""
    found = (models / name for name in inputs if name in PRESETS)
    return tuple(sorted(path for folder in found for path in folder.iterdir() if path.is_file()))
