"""One estimator on all its inputs of one photographed pair, and how far its answers are from the truth.

Estimators are imported when they run, not when this module is: a stored result then depends on the code of its own
estimator alone (`epiprior_lab.evaluation.photographs.estimator_code`), and a changed one leaves the results of the
others be.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from epiprior.geometry import sampson_distance
from epiprior.types import FundamentalEstimate
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.photographs.estimator_code import check_code
from epiprior_lab.evaluation.photographs.measures import pose_errors, symmetric_distance
from epiprior_lab.evaluation.photographs.truth import Truth
from epiprior_lab.features.matching import MatchFiles, PairMatches
from epiprior_lab.labels.ground_truth import errors_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import MeasureParams

if TYPE_CHECKING:
    from epiprior.estimators.handover import HandOver

Row = dict[str, Any]


def photograph_rows(
    *,
    pair: Pair,
    truth: Truth,
    matches: MatchFiles,
    estimator: str,
    code: str,
    seeds: Sequence[int],
    hand_overs: Mapping[str, HandOver],
    measures: MeasureParams,
) -> list[Row]:
    """Return one row per input and seed for one estimator.

    Parameters
    ----------
    pair : Pair
        Gives cameras, where known.
    truth : Truth
        As from `pair_facts`.
    matches : MatchFiles
        The inputs that the estimator gets, in the order of the rows.
    estimator : str
        Name in the registry. A deterministic one runs once, and its row is repeated.
    code : str
        `estimator_code` of the estimator, where the task was given out: part of the task's key.
    seeds : sequence of int
        Each becomes a child seed of the pair, the same for every input, so that differences are paired.
    hand_overs : mapping of str to HandOver
        Per input.
    measures : MeasureParams
        Of the normalised symmetric geometric distance.

    Returns
    -------
    list of dict
        ``estimator, input, seed, status, support`` out of so many ``matches``, ``spread, plausibility``,
        ``iterations``, and the measures of
        `measured`.

    Raises
    ------
    SettingsError
        If this process has other code of the estimator.
    """
    check_code(estimator, code)
    found_estimator = importlib.import_module("epiprior.estimators").find_estimator(estimator)
    different = seeds[:1] if getattr(found_estimator, "deterministic", False) else seeds
    sets = matches.read()
    rows = []
    for name in sets.sets:
        found = []
        for seed in different:
            estimate = run_estimator(sets, pair, estimator=estimator, name=name, seed=seed, how=hand_overs[name])
            about = {"status": str(estimate.status), "support": estimate.support, "matches": len(estimate.x1)}
            about |= {"spread": estimate.spread, "plausibility": estimate.plausibility}
            about |= {"iterations": estimate.iterations}
            threshold_px = hand_overs[name].threshold_px * max(sets.pixel_factors)
            found.append(about | measured(estimate, pair, truth, measures, threshold_px=threshold_px))
        rows += [
            {"estimator": estimator, "input": name, "seed": seed, **found[min(k, len(found) - 1)]}
            for k, seed in enumerate(seeds)
        ]
    return rows


def run_estimator(
    sets: PairMatches, pair: Pair, *, estimator: str, name: str, seed: int, how: HandOver
) -> FundamentalEstimate:
    """Run one estimator on one input of one pair, under the child seed of the pair."""
    estimate: FundamentalEstimate = importlib.import_module("epiprior.estimators.run").estimate_from_matches(
        sets.sets[name],
        estimator=estimator,
        seed=child_seed(seed, pair.pair_id),
        hand_over=how,
        pixel_factors=sets.pixel_factors,
    )
    return estimate


def measured(
    estimate: FundamentalEstimate, pair: Pair, truth: Truth, measures: MeasureParams, *, threshold_px: float
) -> Row:
    """Return how far F is from the truth, before the verdict.

    Parameters
    ----------
    estimate : FundamentalEstimate
        Its `raw_F` is measured: the verdict has a table of its own (`epiprior_lab.report.verdicts`).
    pair, truth, measures
        As for `photograph_rows`.
    threshold_px : float
        Matches within it choose among the four poses of F, pixels.

    Returns
    -------
    dict
        ``error_px`` (mean over control points of the root of the Sampson distance) and ``median_error_px``;
        ``distance``, the normalised symmetric geometric distance; ``rotation_deg`` and ``translation_deg``. NaN
        without an F, or where the pair has no true F or no cameras.
    """
    row: Row = dict.fromkeys(("error_px", "median_error_px", "distance", "rotation_deg", "translation_deg"), np.nan)
    F = estimate.raw_F
    if F is None:
        return row
    errors = errors_px(F, truth.x1, truth.x2)
    row |= {"error_px": float(errors.mean()), "median_error_px": float(np.median(errors))}
    if truth.F is not None:
        seed = child_seed(measures.seed, pair.pair_id)
        row["distance"] = symmetric_distance(F, truth.F, pair.sizes(), points=measures.distance_points, seed=seed)
    if pair.camera1 is not None and pair.camera2 is not None:
        near = sampson_distance(F, estimate.x1, estimate.x2) < threshold_px
        angles = pose_errors(F, (pair.camera1, pair.camera2), estimate.x1[near], estimate.x2[near])
        row |= dict(zip(("rotation_deg", "translation_deg"), angles, strict=True))
    return row
