"""Figures of the analysis: the paper's curves, ablations, and where successes are lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from epiprior_lab.evaluation.statistics import success_curve
from epiprior_lab.report.analysis_tables import Analysis, curve_errors
from epiprior_lab.report.study import order_of
from epiprior_lab.report.style import GRID, INK, MUTED, SERIES, Look, save, styled

CURVE_LIMIT_PX = 20.0
_BARS_PX = np.array([3.5, 7.0, 12.5, 17.0])

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

VARIANT_NAMES = {
    "default": "as it is",
    "X alone": "X without X_L and X_B",
    "frames of SIFT": "frames of SIFT",
    "oriented matches": "two oriented matches",
}

LOST = {
    "chosen": ("right F chosen", "#009e73"),
    "missed": ("right F missed", "#56b4e9"),
    "outscored": ("right F outscored", "#e69f00"),
    "hypothesis": ("no good hypothesis", "#d55e00"),
    "matches": ("too few right matches", "#8b919b"),
}


def steps_figure(analysis: Analysis, path: Path, limit_px: float = CURVE_LIMIT_PX) -> Path:
    """Draw successful pairs over the threshold for every step: the paper's figure, a panel per complete family.

    Bars are one standard deviation over seeds.
    """
    grid = np.linspace(0, limit_px, 201)
    families = analysis.complete_families
    steps = analysis.results[analysis.results["experiment"] == "steps"]
    # Of a step that several estimators ran on, the first one's curve is drawn.
    first = steps.drop_duplicates("variant").set_index("variant")["estimator"]
    looks = {name: _named(look, name, str(first[name])) for name, look in STEP_LOOKS.items() if name in first.index}
    with styled(1, len(families), (4.6 * len(families), 4.4), sharey=True) as (figure, axes):
        for axis, family in zip(axes[0], families, strict=True):
            for k, (name, look) in enumerate(looks.items()):
                errors = curve_errors(analysis, family, name, str(first[name]))
                axis.plot(
                    grid, success_curve(errors, grid)[0], color=look.colour, ls=look.line,
                    lw=2.4 if name == "beyond" else 1.7,
                )  # fmt: skip
                at = _BARS_PX + 0.25 * (k - (len(looks) - 1) / 2)  # side by side, so that bars do not hide bars
                mean, deviation = success_curve(errors, at)
                axis.errorbar(at, mean, deviation, fmt="none", ecolor=look.colour, elinewidth=0.9, alpha=0.8)
            axis.axvline(10, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
            axis.set(title=family, xlim=(0, limit_px), ylim=(0, len(errors) * 1.02), xlabel="threshold, px")
        axes[0][0].set_ylabel("successful pairs")
        _legend(figure, looks, columns=2 * len(families))
        return save(figure, path)


def _legend(figure: Figure, looks: Mapping[str, Look], *, columns: int) -> None:
    handles = [
        Line2D([], [], color=look.colour, linestyle=look.line, marker=look.marker, label=look.label)
        for look in looks.values()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, handlelength=2.6)


def _named(look: Look, name: str, estimator: str) -> Look:
    label = f"{look.label}, {estimator}" if name in ("default", "beyond") else look.label
    return Look(label, look.colour, look.line, look.marker)


def ablation_figure(
    rankings: pd.DataFrame, successes: pd.DataFrame, thresholds_px: Sequence[float], path: Path
) -> Path:
    """Draw each variant's precision and successes as dots with 95 % intervals, a row per family.

    Parameters
    ----------
    rankings, successes : DataFrame
        As from `analysis_tables.ranking_table` and `success_table`.
    thresholds_px : sequence of float
        Which successes.
    path : Path
        PNG file.
    """
    ablation = successes[successes["experiment"] == "ablation"]
    families = order_of(ablation["family"])
    measures = [("precision_10", "right of the first 10"), ("precision_100", "right of the first 100")]
    columns = len(measures) + len(thresholds_px)
    sizes = [ablation[ablation["family"] == f]["variant"].nunique() for f in families]
    with styled(len(families), columns, (2.5 * columns + 1.6, 0.34 * sum(sizes) + 0.75 * len(families) + 0.7)) as (
        figure,
        axes,
    ):
        grid = axes[0][0].get_gridspec()
        assert grid is not None
        grid.set_height_ratios([n + 1.2 for n in sizes])
        for row, family in zip(axes, families, strict=True):
            of_family = rankings[rankings["family"] == family]
            variants = order_of(ablation[ablation["family"] == family]["variant"])
            variants.sort(key=lambda name: name != "default")
            for axis, (measure, title) in zip(row, measures, strict=False):
                _dots(axis, of_family, variants, measure)
                axis.set(xlim=(0, 1.02), title=title if row is axes[0] else "")
            for axis, threshold in zip(row[len(measures) :], thresholds_px, strict=True):
                part = ablation[(ablation["family"] == family) & (ablation["threshold_px"] == threshold)]
                _dots(axis, part, variants, "successes")
                title = f"pairs below {threshold:g} px"
                axis.set(xlim=(0, 1.02 * part["pairs"].max()), title=title if row is axes[0] else "")
            for axis in row:
                names = [VARIANT_NAMES.get(name, name) for name in variants]
                axis.set_yticks(np.arange(len(variants))[::-1], names if axis is row[0] else [""] * len(names))
                axis.set_ylim(-0.6, len(variants) - 0.4)
                axis.tick_params(axis="y", labelsize=9, labelcolor=INK)
                axis.grid(axis="y", visible=False)
            row[0].set_ylabel(family, fontweight="bold")
        _legend(figure, _RANKING_LOOKS, columns=2)
        return save(figure, path)


_RANKING_LOOKS = {
    "final": Look("ranked by probability (one model for all)", SERIES[1], "", "o"),
    "sfm": Look("ranked by sfm alone (no model)", SERIES[0], "", "D"),
}


def _dots(axis: Axes, table: pd.DataFrame, variants: Sequence[str], measure: str) -> None:
    for k, (ranking, look) in enumerate(_RANKING_LOOKS.items()):
        part = table[table["ranking"] == ranking].drop_duplicates("variant").set_index("variant")
        there = [name for name in variants if name in part.index]
        value = part.loc[there, measure].to_numpy(np.float64)
        ends = part.loc[there, [f"{measure}_low", f"{measure}_high"]].to_numpy(np.float64).T
        height = np.array([len(variants) - 1 - variants.index(name) for name in there]) + 0.13 * (1 - 2 * k)
        bars = np.abs(ends - value)
        axis.errorbar(value, height, xerr=bars, fmt=look.marker, color=look.colour, ms=5, lw=1.1, mec="white", mew=0.6)
    for name in variants[:1]:
        reference = table[(table["variant"] == name) & (table["ranking"] == "final")][measure]
        axis.axvline(float(reference.iloc[0]), color=GRID, lw=1.6, zorder=0)


def lost_figure(lost: pd.DataFrame, path: Path) -> Path:
    """Draw where successes are lost as stacked bars: a panel per threshold, a bar per family and estimator.

    Parameters
    ----------
    lost : DataFrame
        As from `analysis_tables.lost_table`.
    path : Path
        PNG file.
    """
    thresholds = list(dict.fromkeys(lost["threshold_px"]))
    bars = len(lost) // len(thresholds)
    with styled(1, len(thresholds), (4.4 * len(thresholds) + 1.2, 0.5 * bars + 1.3), sharey=True) as (figure, axes):
        for axis, threshold in zip(axes[0], thresholds, strict=True):
            part = lost[lost["threshold_px"] == threshold]
            y = np.arange(len(part))[::-1]
            left = np.zeros(len(part))
            for name, (label, colour) in LOST.items():
                width = part[name].to_numpy(np.float64)
                axis.barh(y, width, 0.62, left=left, color=colour, label=label, edgecolor="white", lw=0.6)
                for at, start, size in zip(y, left, width, strict=True):
                    if size >= 0.06 * part["pairs"].max():
                        axis.text(
                            start + size / 2, at, f"{size:.1f}", ha="center", va="center", color="white", fontsize=8
                        )
                left += width
            axis.set(title=f"below {threshold:g} px", xlabel="pairs", xlim=(0, part["pairs"].max()))
            axis.set_yticks(y, [f"{f}\n{e}" for f, e in zip(part["family"], part["estimator"], strict=True)])
            axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
            axis.grid(axis="y", visible=False)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        return save(figure, path)
