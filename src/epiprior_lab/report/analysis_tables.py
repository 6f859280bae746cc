"""Tables of the analysis: successes of the variants, their rankings, and where successes are lost."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import FloatArray
from epiprior_lab.analysis.records import NO_ESTIMATOR, Analysis
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.statistics import bootstrap_mean, paired_bootstrap
from epiprior_lab.report.results import interval_columns, where
from epiprior_lab.report.text import order_of

PRECISIONS = ("precision_10", "precision_100", "average_precision")
ENOUGH = (8, 15)  # right one-to-one matches: an F is determined; an F is found
_KEY = ["experiment", "variant", "ranking", "estimator"]
Key = tuple[str, ...]


def errors_of(variants: pd.DataFrame, **values: str) -> pd.DataFrame:
    """Return the errors of the rows with these values: a row per pair, a column per seed, inf without an F."""
    errors = where(variants, **values).set_index(["pair_id", "seed"])["error_px"]
    return errors.fillna(np.inf).unstack("seed").sort_index()


def rate_of(variants: pd.DataFrame, threshold: float, **values: str) -> FloatArray:
    """Return the share of successful seeds of each pair, by pair id, among the rows with these values."""
    return np.asarray((errors_of(variants, **values) < threshold).mean(axis=1), np.float64)


def reference_of(key: Key, main: str) -> Key:
    """Return what a variant is compared with: the whole method, as printed or `default`.

    A key holds experiment, variant, ranking and estimator; runs without an estimator are compared with runs of `main`.
    """
    experiment, variant, ranking, estimator = key
    if experiment == "ablation":
        return ("ablation", "default", ranking, estimator)
    if experiment == "steps":
        return ("steps", "paper", "final", estimator if variant in ("sfm", "paper") else main)
    return ("oracle", "default", "final", estimator if variant in ("default", "true labels") else main)


def success_table(
    analysis: Analysis, main: str, *, thresholds_px: Sequence[float], draws: int, seed: int
) -> pd.DataFrame:
    """Return successes of every variant in every group; `main` is the estimator of all variants.

    Columns: ``threshold_px, group, experiment, variant, ranking, estimator, pairs``; ``successes``, the mean over seeds
    of the number of pairs; ``difference`` from `reference_of`, in pairs, empty for a reference; both with intervals.
    """
    rows = []
    for threshold in thresholds_px:
        for group, variants in analysis.variants.groupby("group", sort=False):
            scenes = variants.groupby("pair_id")["scene"].first().astype(str).tolist()
            parts = {tuple(map(str, key)): part for key, part in variants.groupby(_KEY, sort=False)}
            rates = {key: rate_of(part, threshold) for key, part in parts.items()}
            child = {"draws": draws, "seed": child_seed(seed, str(group), str(threshold))}
            for key, rate in rates.items():
                n = len(rate)
                row: dict[str, Any] = {"threshold_px": threshold, "group": group, **dict(zip(_KEY, key, strict=True))}
                row |= {"pairs": n, **interval_columns("successes", bootstrap_mean(rate, groups=scenes, **child), n)}
                reference = reference_of(key, main)
                if reference in rates and reference != key:
                    got = paired_bootstrap(rates[reference], rate, groups=scenes, **child)
                    row |= interval_columns("difference", got.difference, n)
                rows.append(row)
    return pd.DataFrame(rows)


def precision_table(analysis: Analysis, *, draws: int, seed: int) -> pd.DataFrame:
    """Return the mean precision at 10 and 100 and the average precision of every variant's rankings, per group."""
    rows = []
    for (group, variant, ranking), part in analysis.precision.groupby(["group", "variant", "ranking"], sort=False):
        row: dict[str, Any] = {"group": group, "variant": variant, "ranking": ranking, "pairs": len(part)}
        scenes = part["scene"].astype(str).tolist()
        for measure in PRECISIONS:
            child = child_seed(seed, str(group), measure)
            row |= interval_columns(measure, bootstrap_mean(part[measure], draws=draws, seed=child, groups=scenes))
        rows.append(row)
    return pd.DataFrame(rows)


def limits_table(analysis: Analysis) -> pd.DataFrame:
    """Return what the pairs of every group allow.

    Columns: ``group, pairs``; medians of ``right_in_x``, right one-to-one matches of X, and of ``good_rough``, the
    share of good rough matrices; shares of pairs with at least 8 and 15 right matches, ``enough_8, enough_15``.
    """
    rows = []
    for group, part in analysis.limits.groupby("group", sort=False):
        right = part["right_one_to_one_in_x"]
        good = part["good_rough_matrices"] / part["rough_matrices"].clip(lower=1)
        row: dict[str, Any] = {"group": group, "pairs": len(part), "right_in_x": float(right.median())}
        row |= {f"enough_{n}": float((right >= n).mean()) for n in ENOUGH}
        rows.append(row | {"good_rough": float(good.median())})
    return pd.DataFrame(rows)


def lost_table(analysis: Analysis, thresholds_px: Sequence[float]) -> pd.DataFrame:
    """Return where successes are lost.

    One row per threshold, completely analysed group and estimator on the preset `default`, in pairs (means over
    seeds): ``chosen``, successes; where a refined rough F would have been one, ``missed``, the chosen F has no more
    support, weighted by the probabilities, than the best supported F of the oracles that is a success there, or
    ``outscored``, it has more; ``hypothesis``, no rough F, but a fit to the right matches; ``matches``, not even that.
    """
    oracle = analysis.variants[analysis.variants["experiment"] == "oracle"]
    rows = []
    for threshold in thresholds_px:
        for group in order_of(analysis.limits["group"]):
            part = oracle[oracle["group"] == group]
            good = rate_of(part, threshold, variant="best rough F, refined on all") > 0
            fit = rate_of(part, threshold, variant="right matches") > 0
            known = part[(part["estimator"] == NO_ESTIMATOR) & (part["error_px"] < threshold)]
            truth = known.groupby("pair_id")["score"].max()  # of an F that is right at this threshold
            ours = part[part["variant"] == "default"]
            for estimator in order_of(ours["estimator"]):
                own = ours[ours["estimator"] == estimator]
                rate = rate_of(own, threshold)
                failed_above = ~(own["error_px"] < threshold) & (own["score"] > own["pair_id"].map(truth))
                outscored = failed_above.groupby(own["pair_id"]).mean().sort_index().to_numpy()[good].sum()
                lost = 1 - rate
                row = {"threshold_px": threshold, "group": group, "estimator": estimator, "pairs": len(rate)}
                row |= {"chosen": rate.sum(), "missed": lost[good].sum() - outscored, "outscored": outscored}
                rows.append(row | {"hypothesis": lost[~good & fit].sum(), "matches": lost[~good & ~fit].sum()})
    return pd.DataFrame(rows)
