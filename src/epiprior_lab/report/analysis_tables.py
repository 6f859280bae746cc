"""Tables of the analysis: successes of the variants, their rankings, and where successes are lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import FloatArray
from epiprior_lab.analysis.bench import NO_ESTIMATOR
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.statistics import bootstrap_mean, paired_bootstrap
from epiprior_lab.report.performance import interval_cells
from epiprior_lab.report.study import errors_of, order_of, read_table, success_rates

COLUMNS = {
    "results": "family pair_id scene experiment variant ranking estimator seed status error_px score",
    "rankings": "family pair_id scene variant ranking matches right precision_10 precision_100 average_precision",
    "limits": "family pair_id scene matches right_one_to_one right_one_to_one_in_x rough_matrices good_rough_matrices",
}
ENOUGH = (8, 15)  # right one-to-one matches: an F is decided; an F is found
BEST_HYPOTHESIS = "best rough F, refined on all"
CEILING = "right matches"
_KEY = ["experiment", "variant", "ranking", "estimator"]


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """What the analysis left behind, columns as in `COLUMNS`.

    Parameters
    ----------
    results, rankings, limits : DataFrame
        As in the files of these names; `limits` holds the families that were analysed completely.
    """

    results: pd.DataFrame
    rankings: pd.DataFrame
    limits: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> Analysis:
        """Read the files of a folder.

        Raises
        ------
        ReportError
            If one is missing or lacks a column.
        """
        return cls(**{name: read_table(folder / f"{name}.csv", columns) for name, columns in COLUMNS.items()})

    @property
    def families(self) -> list[str]:
        """All families, in their order."""
        return order_of(self.results["family"])

    @property
    def estimator(self) -> str:
        """The estimator that every variant runs on."""
        return str(self.results["estimator"].iloc[0])

    @property
    def complete_families(self) -> list[str]:
        """Families on which everything was run."""
        return order_of(self.limits["family"])


def success_table(analysis: Analysis, *, thresholds_px: Sequence[float], draws: int, seed: int) -> pd.DataFrame:
    """Return successes of every variant on every family, and the difference from its reference.

    Parameters
    ----------
    analysis : Analysis
        Rows of all pairs.
    thresholds_px : sequence of float
        Thresholds of success, pixels.
    draws, seed : int
        Of the bootstrap, which draws whole scenes.

    Returns
    -------
    DataFrame
        ``threshold_px, family, experiment, variant, ranking, estimator, pairs``; ``successes``, the mean over seeds
        of the number of pairs; ``difference`` from `reference_of`, in pairs, empty for a reference; both with the
        ends of their 95 % interval, ``_low`` and ``_high``.
    """
    rows = []
    for threshold in thresholds_px:
        for family in analysis.families:
            results = analysis.results[analysis.results["family"] == family]
            rates, scenes = _rates(results, threshold)
            child = child_seed(seed, family, str(threshold))
            for key, rate in rates.items():
                n = len(rate)
                row: dict[str, Any] = {"threshold_px": threshold, "family": family, **dict(zip(_KEY, key, strict=True))}
                row["pairs"] = n
                row |= interval_cells("successes", bootstrap_mean(rate, draws=draws, seed=child, groups=scenes), n)
                reference = reference_of(key, analysis.estimator)
                if reference in rates and reference != key:
                    got = paired_bootstrap(rates[reference], rate, draws=draws, seed=child, groups=scenes)
                    row |= interval_cells("difference", got.difference, n)
                rows.append(row)
    return pd.DataFrame(rows)


def _rates(results: pd.DataFrame, threshold: float) -> tuple[dict[tuple[str, ...], FloatArray], list[str]]:
    """Return the share of successful seeds of each pair for every variant, and the pairs' scenes."""
    found: dict[tuple[str, ...], FloatArray] = {}
    scenes: list[str] = []
    for key, part in results.groupby(_KEY, sort=False):
        found[names_of(key)], scenes = success_rates(part, threshold)
    return found, scenes


def names_of(key: object) -> tuple[str, ...]:
    """Return the key of a group by several columns."""
    assert isinstance(key, tuple)
    return tuple(str(part) for part in key)


def reference_of(key: tuple[str, ...], main: str) -> tuple[str, ...]:
    """Return what a variant is compared with: the whole method, as printed or `default`.

    Parameters
    ----------
    key : tuple of str
        Experiment, variant, ranking, estimator.
    main : str
        The estimator of all variants, with which is compared what no estimator made. What another one makes of a
        part is compared with what it makes of the whole.
    """
    experiment, variant, ranking, estimator = key
    if experiment == "ablation":
        return ("ablation", "default", ranking, estimator)
    if experiment == "steps":
        return ("steps", "paper", "final", estimator if variant in ("sfm", "paper") else main)
    return ("oracle", "default", "final", estimator if variant in ("default", "true labels") else main)


def ranking_table(analysis: Analysis, *, draws: int, seed: int) -> pd.DataFrame:
    """Return the mean precision at 10 and 100 of every variant's rankings, with intervals, per family."""
    rows = []
    for key, part in analysis.rankings.groupby(["family", "variant", "ranking"], sort=False):
        names = names_of(key)
        row: dict[str, Any] = dict(zip(("family", "variant", "ranking"), names, strict=True)) | {"pairs": len(part)}
        for measure in ("precision_10", "precision_100", "average_precision"):
            child = child_seed(seed, names[0], measure)
            interval = bootstrap_mean(
                part[measure].to_numpy(), draws=draws, seed=child, groups=[str(s) for s in part["scene"]]
            )
            row |= interval_cells(measure, interval)
        rows.append(row)
    return pd.DataFrame(rows)


def limits_table(analysis: Analysis) -> pd.DataFrame:
    """Return what the pairs of every family allow.

    Returns
    -------
    DataFrame
        ``family, pairs``, medians of ``right_one_to_one_in_x`` and of the share of good rough matrices, and the
        share of pairs with at least 8 and 15 right one-to-one matches among X: ``enough_8``, ``enough_15``.
    """
    rows = []
    for family in analysis.complete_families:
        part = analysis.limits[analysis.limits["family"] == family]
        right = part["right_one_to_one_in_x"]
        good = part["good_rough_matrices"] / part["rough_matrices"].clip(lower=1)
        row: dict[str, Any] = {"family": family, "pairs": len(part), "right_in_x": float(right.median())}
        row |= {f"enough_{n}": float((right >= n).mean()) for n in ENOUGH}
        rows.append(row | {"good_rough": float(good.median())})
    return pd.DataFrame(rows)


def lost_table(analysis: Analysis, thresholds_px: Sequence[float]) -> pd.DataFrame:
    """Return where successes are lost.

    Parameters
    ----------
    analysis : Analysis
        Rows of all pairs.
    thresholds_px : sequence of float
        Thresholds of success, pixels.

    Returns
    -------
    DataFrame
        One row per threshold, complete family and estimator on the preset `default`, in pairs (means over seeds):
        ``chosen``, successes; where a refined rough F would have been one, ``missed``, the chosen F has no more
        support, weighted by the probabilities, than the best supported F of the oracles that is a success at this
        threshold, or ``outscored``, it has more; ``hypothesis``, no rough F would have been a success, but a fit to
        the right matches; ``matches``, not even that.
    """
    rows = []
    for threshold in thresholds_px:
        for family in analysis.complete_families:
            results = analysis.results[analysis.results["family"] == family]
            oracle = results[results["experiment"] == "oracle"]
            good = success_rates(oracle, threshold, variant=BEST_HYPOTHESIS)[0] > 0
            fit = success_rates(oracle, threshold, variant=CEILING)[0] > 0
            ours = oracle[oracle["variant"] == "default"]
            truth = _truth_scores(oracle, threshold)
            for estimator in order_of(ours["estimator"]):
                part = ours[ours["estimator"] == estimator]
                rate, _ = success_rates(part, threshold)
                lost = 1 - rate
                outscored = _outscored(truth, part, threshold)[good].sum()
                row = {"threshold_px": threshold, "family": family, "estimator": estimator, "pairs": len(rate)}
                row |= {"chosen": rate.sum(), "missed": lost[good].sum() - outscored, "outscored": outscored}
                rows.append(row | {"hypothesis": lost[~good & fit].sum(), "matches": lost[~good & ~fit].sum()})
    return pd.DataFrame(rows)


def _truth_scores(oracle: pd.DataFrame, threshold: float) -> pd.Series[float]:
    """Return, by pair, the most weighted support of any F of the oracles whose error is below the threshold."""
    known = oracle[(oracle["estimator"] == NO_ESTIMATOR) & (oracle["error_px"] < threshold)]
    return known.groupby("pair_id")["score"].max()


def _outscored(truth: pd.Series[float], part: pd.DataFrame, threshold: float) -> FloatArray:
    """Return, per pair, the share of seeds that failed with an F of more weighted support than the true one."""
    failed = ~(part["error_px"] < threshold)
    return np.asarray(
        (failed & (part["score"] > part["pair_id"].map(truth))).groupby(part["pair_id"]).mean().sort_index(), np.float64
    )


def curve_errors(analysis: Analysis, family: str, variant: str, estimator: str) -> FloatArray:
    """Return the errors of one curve of the figure of steps, (pairs, seeds)."""
    results = analysis.results[analysis.results["experiment"] == "steps"]
    return errors_of(results, family=family, variant=variant, estimator=estimator).to_numpy(np.float64)
