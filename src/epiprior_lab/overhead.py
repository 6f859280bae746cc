"""Time with the preprocessing step over time without, against what the step contributes.

After the paper's figure of time overhead. Times are wall times of one process on a few pairs of each family;
nothing else in the study reads them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from epiprior.baselines import standard_matches
from epiprior.estimate import estimate_from_matches
from epiprior.preprocess import rank_matches
from epiprior.types import MatchSet
from epiprior_lab.datasets import Pair
from epiprior_lab.evaluation import HandOvers
from epiprior_lab.reports.study import order_of, success_rates
from epiprior_lab.reports.style import MUTED, SERIES, save, styled
from epiprior_lab.seeds import child_seed
from epiprior_lab.statistics import contribution

Row = dict[str, Any]

TIMED_INPUTS = ("standard", "paper", "default")
_MARKERS = ("o", "s", "^", "D", "v", "P")


def measure_pair(pair: Pair, estimators: Sequence[str], hand_overs: HandOvers, seeds: Sequence[int]) -> list[Row]:
    """Time matching and estimation of one pair.

    Parameters
    ----------
    pair : Pair
        Its images are read anew for each input, since that is what a user pays.
    estimators : sequence of str
        Names in the registry.
    hand_overs : mapping
        ``hand_overs[estimator][input]``.
    seeds : sequence of int
        The estimator's time is the mean over them.

    Returns
    -------
    list of dict
        ``pair_id, scene, input, estimator, matching_seconds`` (features and everything up to the handed-over
        matches) and ``estimator_seconds`` (all roll hypotheses).
    """
    rows: list[Row] = []
    for name in TIMED_INPUTS:
        start = time.perf_counter()
        sets = _match(pair, name)
        matching = time.perf_counter() - start
        for estimator in estimators:
            start = time.perf_counter()
            for seed in seeds:
                estimate_from_matches(
                    sets,
                    estimator=estimator,
                    seed=child_seed(seed, pair.pair_id),
                    hand_over=hand_overs[estimator][name],
                )
            rows.append(
                {
                    "pair_id": pair.pair_id,
                    "scene": pair.scene,
                    "input": name,
                    "estimator": estimator,
                    "matching_seconds": matching,
                    "estimator_seconds": (time.perf_counter() - start) / len(seeds),
                }
            )
    return rows


def _match(pair: Pair, name: str) -> tuple[MatchSet, ...]:
    if name == "standard":
        return (standard_matches(pair.image1, pair.image2),)
    return rank_matches(pair.image1, pair.image2, preset=name).sets


def overhead_table(timings: pd.DataFrame, results: pd.DataFrame, threshold_px: float) -> pd.DataFrame:
    """Return one row per preset, family and estimator.

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
        ``preset, family, estimator, seconds_without, seconds_with`` (means over pairs), ``overhead`` (their
        ratio, the paper's definition) and ``contribution``.
    """
    total = timings.assign(seconds=timings["matching_seconds"] + timings["estimator_seconds"])
    means = total.groupby(["family", "estimator", "input"], sort=False)["seconds"].mean()
    rows = []
    for preset in (name for name in TIMED_INPUTS if name != "standard"):
        for family in order_of(timings["family"]):
            for estimator in order_of(timings["estimator"]):
                without = float(means[family, estimator, "standard"])
                with_step = float(means[family, estimator, preset])
                where = {"family": family, "estimator": estimator}
                a, _ = success_rates(results, threshold_px, input="standard", **where)
                b, _ = success_rates(results, threshold_px, input=preset, **where)
                rows.append(
                    {
                        "preset": preset,
                        **where,
                        "seconds_without": without,
                        "seconds_with": with_step,
                        "overhead": with_step / without,
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


def overhead_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw overhead over contribution: one point per family and estimator, one panel per preset."""
    presets, families = order_of(table["preset"]), order_of(table["family"])
    estimators = order_of(table["estimator"])
    with styled(1, len(presets), (4.6 * len(presets) + 1.2, 3.9), sharey=True) as (figure, axes):
        for axis, preset in zip(axes[0], presets, strict=True):
            part = table[(table["preset"] == preset) & np.isfinite(table["contribution"])]
            for row in part.to_dict("records"):
                axis.scatter(
                    100 * row["contribution"],
                    row["overhead"],
                    s=52,
                    color=SERIES[families.index(row["family"]) % len(SERIES)],
                    marker=_MARKERS[estimators.index(row["estimator"]) % len(_MARKERS)],
                    edgecolor="white",
                    linewidth=0.8,
                    zorder=3,
                )
            rank = correlation(table[table["preset"] == preset])
            left_out = int((table["preset"] == preset).sum() - len(part))
            note = f"rank correlation {rank:+.2f}" if np.isfinite(rank) else "no correlation: no variation"
            if left_out:
                note += f"\n{left_out} not shown: nothing succeeded without"
            axis.text(0.98, 0.97, note, transform=axis.transAxes, ha="right", va="top")
            axis.axvline(0, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
            axis.set(title=f"preset {preset}", xlabel="contribution, %")
        axes[0][0].set(ylabel="time with the step / without", ylim=(0, table["overhead"].max() * 1.25))
        for k, family in enumerate(families):
            axes[0][0].plot([], [], "o", color=SERIES[k % len(SERIES)], label=family)
        for k, estimator in enumerate(estimators):
            axes[0][0].plot([], [], _MARKERS[k % len(_MARKERS)], color=MUTED, label=estimator)
        figure.legend(loc="outside right center")
        return save(figure, path)
