"""Tables and figures of the analysis: the paper's curves, variants and their rankings, where successes are lost."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from epiprior.types import FloatArray
from epiprior_lab.analysis.records import NO_ESTIMATOR, Analysis
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.statistics import bootstrap_mean, paired_bootstrap
from epiprior_lab.report import style
from epiprior_lab.report.results import interval_columns, where
from epiprior_lab.report.style import GRID, INK, SERIES, legend, styled
from epiprior_lab.report.text import Look, order_of

PRECISIONS = ("precision_10", "precision_100", "average_precision")
ENOUGH = (8, 15)  # right one-to-one matches: an F is determined; an F is found
_KEY = ["experiment", "variant", "ranking", "estimator"]
Key = tuple[str, ...]
STEP_LOOKS = {
    "standard": Look("standard input (X_L)", "#8b919b", ":", ""),
    "single F": Look("best single rough F", "#56b4e9", ":", ""),
    "single F, refined": Look("best single rough F, refined", "#56b4e9", "-", ""),
    "2keypoint": Look("2keypoints alone", "#009e73", "-.", ""),
    "sfm": Look("sfm alone", "#cc79a7", "--", ""),
    "paper": Look("all measures, as printed", "#2b2f36", "-", ""),
    "default": Look("ours, default", "#e69f00", "-", ""),
    "beyond": Look("ours, default", "#d55e00", "-", ""),
}
VARIANT_NAMES = {"default": "as it is", "X alone": "X without X_L and X_B", "oriented matches": "two oriented matches"}
LOST = {
    "chosen": ("right F chosen", "#009e73"),
    "missed": ("right F missed", "#56b4e9"),
    "outscored": ("right F outscored", "#e69f00"),
    "hypothesis": ("no good hypothesis", "#d55e00"),
    "matches": ("too few right matches", "#8b919b"),
}
_RANKING_LOOKS = {
    "final": Look("ranked by probability (one model for all)", SERIES[1], "", "o"),
    "sfm": Look("ranked by sfm alone (no model)", SERIES[0], "", "D"),
}


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
    for threshold, (group, variants) in product(thresholds_px, analysis.variants.groupby("group", sort=False)):
        parts = {tuple(map(str, key)): part for key, part in variants.groupby(_KEY, sort=False)}
        rates = {key: rate_of(part, threshold) for key, part in parts.items()}
        how: dict[str, Any] = {"draws": draws, "seed": child_seed(seed, str(group), str(threshold))}
        how["groups"] = variants.groupby("pair_id")["scene"].first().astype(str).tolist()
        for key, rate in rates.items():
            row: dict[str, Any] = {"threshold_px": threshold, "group": group, **dict(zip(_KEY, key, strict=True))}
            row |= {"pairs": len(rate)} | interval_columns("successes", bootstrap_mean(rate, **how), len(rate))
            reference = reference_of(key, main)
            if reference in rates and reference != key:
                difference = paired_bootstrap(rates[reference], rate, **how).difference
                row |= interval_columns("difference", difference, len(rate))
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
    for threshold, group in product(thresholds_px, order_of(analysis.limits["group"])):
        part = oracle[oracle["group"] == group]
        good = rate_of(part, threshold, variant="best rough F, refined on all") > 0
        fit = rate_of(part, threshold, variant="right matches") > 0
        known = part[(part["estimator"] == NO_ESTIMATOR) & (part["error_px"] < threshold)]
        truth = known.groupby("pair_id")["score"].max()  # of an F that is right at this threshold
        for estimator, own in part[part["variant"] == "default"].groupby("estimator", sort=False):
            rate = rate_of(own, threshold)
            failed_above = ~(own["error_px"] < threshold) & (own["score"] > own["pair_id"].map(truth))
            outscored = failed_above.groupby(own["pair_id"]).mean().sort_index().to_numpy()[good].sum()
            lost = 1 - rate
            row = {"threshold_px": threshold, "group": group, "estimator": estimator, "pairs": len(rate)}
            row |= {"chosen": rate.sum(), "missed": lost[good].sum() - outscored, "outscored": outscored}
            rows.append(row | {"hypothesis": lost[~good & fit].sum(), "matches": lost[~good & ~fit].sum()})
    return pd.DataFrame(rows)


def steps_figure(analysis: Analysis, path: Path) -> None:
    """Draw successful pairs over the threshold for every step: the paper's figure, a panel per complete group.

    Bars are one standard deviation over seeds. Of a step with several estimators, the first one's curve is drawn.
    """
    groups = order_of(analysis.limits["group"])
    steps = analysis.variants[analysis.variants["experiment"] == "steps"]
    first = steps.drop_duplicates("variant").set_index("variant")["estimator"]
    looks = {name: look for name, look in STEP_LOOKS.items() if name in first.index}
    for name in looks.keys() & {"default", "beyond"}:
        looks[name] = replace(looks[name], label=f"{looks[name].label}, {first[name]}")
    with styled(path, 1, len(groups), (4.6 * len(groups), 4.4), sharey=True) as (figure, axes):
        for axis, group in zip(axes[0], groups, strict=True):
            errors = {
                name: errors_of(steps, group=group, variant=name, estimator=first[name]).to_numpy(np.float64)
                for name in looks
            }
            style.draw_curves(axis, looks, errors, np.array([3.5, 7.0, 12.5, 17.0]), bold="beyond")
            pairs = steps.loc[steps["group"] == group, "pair_id"].nunique()
            axis.set(title=group, ylim=(0, pairs * 1.02), xlabel="threshold, px")
        axes[0][0].set_ylabel("successful pairs")
        legend(figure, list(looks.values()))


def ablation_figure(
    precision: pd.DataFrame, successes: pd.DataFrame, thresholds_px: Sequence[float], path: Path
) -> None:
    """Draw each variant's precision and successes as dots with 95 % intervals, a row per group."""
    ablation = successes[successes["experiment"] == "ablation"]
    panels = [("precision_10", "right of the first 10", 0.0), ("precision_100", "right of the first 100", 0.0)]
    panels += [("successes", f"pairs below {threshold:g} px", threshold) for threshold in thresholds_px]
    groups = order_of(ablation["group"])
    sizes = [ablation[ablation["group"] == g]["variant"].nunique() for g in groups]
    size = (2.5 * len(panels) + 1.6, 0.34 * sum(sizes) + 0.75 * len(groups) + 0.7)
    with styled(path, len(groups), len(panels), size) as (figure, axes):
        grid = axes[0][0].get_gridspec()
        assert grid is not None
        grid.set_height_ratios([n + 1.2 for n in sizes])
        for row, group in zip(axes, groups, strict=True):
            of_group = ablation[ablation["group"] == group]
            variants = sorted(order_of(of_group["variant"]), key=lambda name: name != "default")
            names = [VARIANT_NAMES.get(name, name) for name in variants]
            for axis, (measure, _, threshold) in zip(row, panels, strict=True):
                counted = of_group[of_group["threshold_px"] == threshold]
                _dots(axis, counted if threshold else precision[precision["group"] == group], variants, measure)
                limit = 1.02 * (counted["pairs"].max() if threshold else 1)
                axis.set(xlim=(0, limit), ylim=(-0.6, len(variants) - 0.4))
                axis.set_yticks(np.arange(len(variants))[::-1], names if axis is row[0] else [""] * len(names))
                axis.tick_params(axis="y", labelsize=9, labelcolor=INK)
                axis.grid(axis="y", visible=False)
        style.label_grid(axes, rows=groups, columns=[title for _, title, _ in panels])
        legend(figure, list(_RANKING_LOOKS.values()), markers=True)


def _dots(axis: Axes, table: pd.DataFrame, variants: Sequence[str], measure: str) -> None:
    for k, (ranking, look) in enumerate(_RANKING_LOOKS.items()):
        part = (
            table[table["ranking"] == ranking].drop_duplicates("variant").set_index("variant").reindex(list(variants))
        )
        value, height = part[measure], np.arange(len(variants))[::-1] + 0.13 * (1 - 2 * k)
        bars = [(part[f"{measure}{end}"] - value).abs() for end in ("_low", "_high")]
        axis.errorbar(value, height, xerr=bars, fmt=look.marker, color=look.colour, ms=5, lw=1.1, mec="white", mew=0.6)
        if ranking == "final":  # the method as it is comes first
            axis.axvline(value.iloc[0], color=GRID, lw=1.6, zorder=0)


def lost_figure(lost: pd.DataFrame, path: Path) -> None:
    """Draw where successes are lost as stacked bars: a panel per threshold, a bar per group and estimator."""
    thresholds = list(dict.fromkeys(lost["threshold_px"]))
    size = (4.4 * len(thresholds) + 1.2, 0.5 * (len(lost) // len(thresholds)) + 1.3)
    with styled(path, 1, len(thresholds), size, sharey=True) as (figure, axes):
        for axis, threshold in zip(axes[0], thresholds, strict=True):
            part = lost[lost["threshold_px"] == threshold]
            y, left = np.arange(len(part))[::-1], np.zeros(len(part))
            for name, (label, colour) in LOST.items():
                width = part[name].to_numpy(np.float64)
                drawn = axis.barh(y, width, 0.62, left=left, color=colour, label=label, edgecolor="white", lw=0.6)
                texts = [f"{size:.1f}" if size >= 0.06 * part["pairs"].max() else "" for size in width]
                axis.bar_label(drawn, texts, label_type="center", color="white", fontsize=8)
                left += width
            axis.set(title=f"below {threshold:g} px", xlabel="pairs", xlim=(0, part["pairs"].max()))
            axis.set_yticks(y, [f"{g}\n{e}" for g, e in zip(part["group"], part["estimator"], strict=True)])
            axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
            axis.grid(axis="y", visible=False)
        style.axis_legend(figure, axes[0][0])
