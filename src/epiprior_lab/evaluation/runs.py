"""Runs of estimators on the inputs of a pair, and how far each is from the truth. The loop over both is here alone."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from epiprior.estimators import find_estimator
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches, ready_matches
from epiprior.geometry import sampson_distance
from epiprior.types import FundamentalEstimate
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.distances import pose_errors, symmetric_distance
from epiprior_lab.evaluation.inputs import PairMatches, read_matches
from epiprior_lab.evaluation.records import RunRecord
from epiprior_lab.evaluation.truth import Truth, pair_truth
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import MeasureParams, TruthParams

EstimatorInputs = Mapping[str, Sequence[str]]
HandOvers = Mapping[str, Mapping[str, HandOver]]  # by estimator, then by input
Result = TypeVar("Result")


def each_run(
    run: Callable[..., Result],
    matches: PairMatches,
    pair_id: str,
    *,
    estimator: str,
    seeds: Sequence[int],
    hand_overs: Mapping[str, HandOver],
) -> Iterator[tuple[str, int, Result]]:
    """Yield input, seed and outcome for all inputs in `matches`, and for each of them all `seeds`.

    `run` is `estimate_from_matches`, or takes the same; `hand_overs` are per input. Each seed becomes a child seed of
    the pair, so that differences are paired. A deterministic estimator runs once, and its outcome is repeated.
    """
    different = seeds[:1] if getattr(find_estimator(estimator), "deterministic", False) else seeds
    for name, sets in matches.sets.items():
        ready, how = ready_matches(sets, hand_overs[name], matches.pixel_factors), {"hand_over": hand_overs[name]}
        found = [run(ready, estimator=estimator, seed=child_seed(seed, pair_id), **how) for seed in different]
        for k, seed in enumerate(seeds):
            yield name, seed, found[min(k, len(found) - 1)]


def estimates(
    matches: PairMatches, pair_id: str, *, estimator: str, seeds: Sequence[int], hand_overs: Mapping[str, HandOver]
) -> Iterator[tuple[str, int, FundamentalEstimate]]:
    """Yield input, seed and estimate for all inputs and seeds, as `each_run`."""
    return each_run(estimate_from_matches, matches, pair_id, estimator=estimator, seeds=seeds, hand_overs=hand_overs)


def said(estimate: FundamentalEstimate) -> dict[str, Any]:
    """Return the columns that `RunRecord` and `KindRecord` share: what an estimate says of itself."""
    own = {name: getattr(estimate, name) for name in ("support", "confidence")}
    return own | {name: str(getattr(estimate, name)) for name in ("status", "geometry")} | {"matches": len(estimate.x1)}


def run_record(
    estimate: FundamentalEstimate, pair: Pair, truth: Truth, measures: MeasureParams, *, threshold_px: float, **key: Any
) -> RunRecord:
    """Measure one estimate in every way that the truth of the pair allows.

    Its F is measured whatever its status: a strict verification would flatter the inputs that it spares. Matches
    within `threshold_px` choose among the four poses of F. `key` is group, estimator, input and seed.
    """
    F, cameras = estimate.F, (pair.camera1, pair.camera2)
    names = ("error_px", "median_error_px", "distance", "rotation_deg", "translation_deg")
    measured: dict[str, Any] = dict.fromkeys(names, np.nan)
    if F is not None:
        errors = sampson_distance(F, truth.x1, truth.x2)
        measured |= {"error_px": float(errors.mean()), "median_error_px": float(np.median(errors))}
        if truth.F is not None:
            child = child_seed(measures.seed, pair.pair_id)
            how = {"points": measures.distance_points, "seed": child}
            measured["distance"] = symmetric_distance(F, truth.F, pair.sizes(), **how)
        if cameras[0] is not None and cameras[1] is not None:
            near = sampson_distance(F, estimate.x1, estimate.x2) < threshold_px
            errors_deg = pose_errors(F, (cameras[0], cameras[1]), estimate.x1[near], estimate.x2[near])
            measured["rotation_deg"], measured["translation_deg"] = errors_deg
    return RunRecord(
        **key,
        **said(estimate),
        **measured,
        pair_id=pair.pair_id,
        scene=pair.scene,
        iterations=estimate.iterations,
    )


def run_pair(
    *,
    pair: Pair,
    matches: Mapping[str, Path],
    estimator: str,
    seeds: Sequence[int],
    hand_overs: Mapping[str, HandOver],
    group: str,
    truth: TruthParams,
    measures: MeasureParams,
) -> list[RunRecord]:
    """Return one record per input and seed of one estimator; the files of their `matches` are by input."""
    read, known = read_matches(matches), pair_truth(pair, truth)
    limits = {name: how.threshold_px * max(read.pixel_factors) for name, how in hand_overs.items()}
    key = {"group": group, "estimator": estimator}
    found = estimates(read, pair.pair_id, estimator=estimator, seeds=seeds, hand_overs=hand_overs)
    return [
        run_record(estimate, pair, known, measures, threshold_px=limits[name], input=name, seed=seed, **key)
        for name, seed, estimate in found
    ]
