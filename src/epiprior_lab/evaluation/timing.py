"""Time with the preprocessing step over time without, and of each estimator when it succeeds and when it fails.

After the paper's figure of time overhead. Times are wall times of one process on a few pairs of each family;
nothing else in the study reads them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from epiprior.estimators.run import estimate_from_matches
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.estimates import EstimatorInputs, HandOvers
from epiprior_lab.evaluation.statistics import contribution
from epiprior_lab.features.matching import PRESETS, WITHOUT, match_pair
from epiprior_lab.labels.ground_truth import errors_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.report.study import order_of, success_rates

Row = dict[str, Any]


def measure_pair(pair: Pair, inputs: EstimatorInputs, hand_overs: HandOvers, seeds: Sequence[int]) -> list[Row]:
    """Time matching and estimation of one pair.

    Parameters
    ----------
    pair : Pair
        Its images are read anew for each input, since that is what a user pays.
    inputs : mapping of str to sequence of str
        For each estimator the inputs that it gets.
    hand_overs : mapping
        ``hand_overs[estimator][input]``.
    seeds : sequence of int
        One run each.

    Returns
    -------
    list of dict
        ``pair_id, scene, input, estimator, seed, matching_seconds`` (features and everything up to the ranked
        matches), ``estimator_seconds`` (from matches to F, all roll hypotheses) and ``error_px`` (of F before the
        verdict; NaN without F).
    """
    points = pair.control_points()
    rows: list[Row] = []
    for name in dict.fromkeys(name for names in inputs.values() for name in names):
        start = time.perf_counter()
        matches = match_pair(pair, (name,))
        matching = time.perf_counter() - start
        for estimator in (e for e, names in inputs.items() if name in names):
            for seed in seeds:
                how = hand_overs[estimator][name]
                start = time.perf_counter()
                estimate = estimate_from_matches(
                    matches.sets[name],
                    estimator=estimator,
                    seed=child_seed(seed, pair.pair_id),
                    hand_over=how,
                    pixel_factors=matches.pixel_factors,
                )
                seconds = time.perf_counter() - start
                rows.append(
                    {
                        "pair_id": pair.pair_id,
                        "scene": pair.scene,
                        "input": name,
                        "estimator": estimator,
                        "seed": seed,
                        "matching_seconds": matching,
                        "estimator_seconds": seconds,
                        "error_px": np.nan if estimate.raw_F is None else errors_px(estimate.raw_F, *points).mean(),
                    }
                )
    return rows


def estimator_table(timings: pd.DataFrame, threshold_px: float) -> pd.DataFrame:
    """Return how long each estimator takes on each input when it succeeds and when it fails.

    Parameters
    ----------
    timings : DataFrame
        Rows of `measure_pair`.
    threshold_px : float
        Of success, pixels.

    Returns
    -------
    DataFrame
        ``estimator, input, outcome`` (``success`` or ``failure``), ``runs``, and mean, median and longest
        seconds of the estimator alone; outcomes that did not occur have no row.
    """
    outcome = np.where(timings["error_px"] < threshold_px, "success", "failure")
    rows = []
    for (estimator, name, result), part in timings.assign(outcome=outcome).groupby(
        ["estimator", "input", "outcome"], sort=False
    ):
        seconds = part["estimator_seconds"]
        cells = {"runs": len(part), "mean": seconds.mean(), "median": seconds.median(), "longest": seconds.max()}
        rows.append({"estimator": estimator, "input": name, "outcome": result, **cells})
    return pd.DataFrame(rows)


def overhead_table(timings: pd.DataFrame, results: pd.DataFrame, threshold_px: float) -> pd.DataFrame:
    """Return one row per preset, family and estimator that gets the preset.

    Parameters
    ----------
    timings : DataFrame
        Rows of `measure_pair` with a column ``family``.
    results : DataFrame
        Results of the evaluation of the same families.
    threshold_px : float
        Of the contribution, pixels.

    Returns
    -------
    DataFrame
        ``preset, family, estimator, seconds_without, seconds_with`` (means over runs, matching included),
        ``overhead`` (their ratio, the paper's definition) and ``contribution``.
    """
    total = timings.assign(seconds=timings["matching_seconds"] + timings["estimator_seconds"])
    means = total.groupby(["family", "estimator", "input"], sort=False)["seconds"].mean().to_dict()
    rows = []
    for preset in PRESETS:
        for family in order_of(timings["family"]):
            for estimator in order_of(timings["estimator"]):
                without = next((name for name in WITHOUT if (family, estimator, name) in means), None)
                if without is None or (family, estimator, preset) not in means:
                    continue
                where = {"family": family, "estimator": estimator}
                a, _ = success_rates(results, threshold_px, input=without, **where)
                b, _ = success_rates(results, threshold_px, input=preset, **where)
                before, after = means[family, estimator, without], means[family, estimator, preset]
                rows.append(
                    {
                        "preset": preset,
                        **where,
                        "seconds_without": before,
                        "seconds_with": after,
                        "overhead": after / before,
                        "contribution": float(contribution(a.mean(), b.mean())),
                    }
                )
    return pd.DataFrame(rows)


def correlation(table: pd.DataFrame) -> float:
    """Return Spearman's rank correlation of contribution and overhead; NaN where either does not vary.

    Ranks, because a contribution is infinite where nothing succeeded without the step.
    """
    if table["contribution"].nunique() < 2 or table["overhead"].nunique() < 2:
        return float("nan")
    return float(stats.spearmanr(table["contribution"], table["overhead"]).statistic)
