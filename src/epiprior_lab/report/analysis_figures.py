"""Figures of the analysis: the paper's curves, ablations, and where successes are lost."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from epiprior_lab.analysis.records import Analysis
from epiprior_lab.report import style
from epiprior_lab.report.analysis_tables import errors_of
from epiprior_lab.report.style import GRID, INK, SERIES, legend, styled
from epiprior_lab.report.text import Look, order_of

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
        part = table[table["ranking"] == ranking].drop_duplicates("variant").set_index("variant")
        there = [name for name in variants if name in part.index]
        value = part.loc[there, measure].to_numpy(np.float64)
        ends = part.loc[there, [f"{measure}_low", f"{measure}_high"]].to_numpy(np.float64).T
        height = np.array([len(variants) - 1 - variants.index(name) for name in there]) + 0.13 * (1 - 2 * k)
        bars = np.abs(ends - value)
        axis.errorbar(value, height, xerr=bars, fmt=look.marker, color=look.colour, ms=5, lw=1.1, mec="white", mew=0.6)
        if ranking == "final" and there:
            axis.axvline(value[0], color=GRID, lw=1.6, zorder=0)


def lost_figure(lost: pd.DataFrame, path: Path) -> None:
    """Draw where successes are lost as stacked bars: a panel per threshold, a bar per group and estimator."""
    thresholds = list(dict.fromkeys(lost["threshold_px"]))
    bars = len(lost) // len(thresholds)
    with styled(path, 1, len(thresholds), (4.4 * len(thresholds) + 1.2, 0.5 * bars + 1.3), sharey=True) as (
        figure,
        axes,
    ):
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
