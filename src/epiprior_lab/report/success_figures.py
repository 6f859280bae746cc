"""Figures of the estimators: successes at a glance, success curves, and one estimator against every other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from epiprior_lab.evaluation.statistics import success_curve
from epiprior_lab.report.performance import ALL, COLUMNS
from epiprior_lab.report.study import Study, errors_of, order_of
from epiprior_lab.report.style import GRID, INK, INPUT_LOOKS, MUTED, legend, look_of, save, styled

CURVE_LIMIT_PX = 20.0
_VERDICTS = {"better": "#d55e00", "open": "#8b919b", "worse": "#0072b2"}


def performance_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw successes per family and estimator, one dot per input: the performance table at a glance.

    Parameters
    ----------
    table : DataFrame
        As from `performance.performance_table`; a row of panels per threshold, a column per family.
    path : Path
        PNG file.
    """
    table = table[table["family"] != ALL]
    families, thresholds = order_of(table["family"]), list(dict.fromkeys(table["threshold_px"]))
    estimators = order_of(table["estimator"])
    height = 0.27 * len(estimators) + 0.75
    size = (2.6 * len(families) + 0.8, height * len(thresholds) + 0.4)
    with styled(len(thresholds), len(families), size, sharey=True) as (figure, axes):
        for row, threshold in zip(axes, thresholds, strict=True):
            for axis, family in zip(row, families, strict=True):
                part = table[(table["family"] == family) & (table["threshold_px"] == threshold)]
                _dots(axis, part.set_index("estimator").loc[estimators])
                axis.set_xlabel(f"pairs of {part['pairs'].max()} below {threshold:g} px")
                if row is axes[0]:
                    axis.set_title(family)
        legend(figure, INPUT_LOOKS, [name for name in COLUMNS if table[name].notna().any()], markers=True)
        return save(figure, path)


def _dots(axis: Axes, part: pd.DataFrame) -> None:
    pairs = int(part["pairs"].max())
    y = np.arange(len(part))[::-1]
    for between in y[1:] + 0.5:
        axis.axhline(between, color=GRID, lw=0.8)
    for k, name in enumerate(COLUMNS):
        look = INPUT_LOOKS[name]
        height = y + 0.14 * ((len(COLUMNS) - 1) / 2 - k)  # equal numbers must not hide each other
        axis.errorbar(
            part[name], height, xerr=part[f"{name}_sd"], fmt=look.marker, color=look.colour,
            ms=6 if name == "default" else 4.5, lw=0.9, mec="white", mew=0.6, zorder=3,
        )  # fmt: skip
    axis.set(xlim=(-0.03 * pairs, 1.03 * pairs), ylim=(-0.6, len(part) - 0.4))
    axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))  # pairs are whole
    axis.set_yticks(y, [str(name) for name in part.index])
    axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
    axis.grid(axis="y", visible=False)


def success_figure(study: Study, path: Path, limit_px: float = CURVE_LIMIT_PX) -> Path:
    """Draw successful pairs over the threshold: a row per estimator, a column per family.

    Bars are one standard deviation over seeds, as in the paper's figure of results.
    """
    estimators, inputs = order_of(study.results["estimator"]), order_of(study.results["input"])
    rows, columns = len(estimators), len(study.families)
    size = (2.55 * columns + 0.4, 1.4 * rows + 0.9)
    with styled(rows, columns, size, sharex=True, sharey="col") as (figure, axes):
        for row, estimator in zip(axes, estimators, strict=True):
            of_estimator = study.results[study.results["estimator"] == estimator]
            for axis, family in zip(row, study.families, strict=True):
                _curves(axis, of_estimator[of_estimator["family"] == family], inputs, limit_px)
                if row is axes[0]:
                    axis.set_title(family)
                if row is axes[-1]:
                    axis.set_xlabel("threshold, px")
            row[0].set_ylabel(estimator, fontweight="bold")
        figure.supylabel("successful pairs", fontsize=9, color=MUTED)
        legend(figure, INPUT_LOOKS, [name for name in INPUT_LOOKS if name in inputs])
        return save(figure, path)


def _curves(axis: Axes, results: pd.DataFrame, inputs: Sequence[str], limit_px: float) -> None:
    grid = np.linspace(0, limit_px, 201)
    bars = np.arange(2.5, limit_px, 2.5)
    known = set(results["input"])
    for k, name in enumerate(inputs):
        if name not in known:
            continue
        errors = errors_of(results, input=name).to_numpy()
        look = look_of(INPUT_LOOKS, name, k)
        axis.plot(grid, success_curve(errors, grid)[0], color=look.colour, ls=look.line, lw=1.5)
        at = bars + 0.22 * (k - (len(inputs) - 1) / 2)  # side by side, so that bars do not hide bars
        mean, deviation = success_curve(errors, at)
        axis.errorbar(at, mean, deviation, fmt="none", ecolor=look.colour, elinewidth=0.8, alpha=0.8)
    axis.axvline(10, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
    axis.set(xlim=(0, limit_px), ylim=(0, results["pair_id"].nunique() * 1.03))
    axis.yaxis.set_major_locator(MaxNLocator(5, integer=True))


def duel_figure(table: pd.DataFrame, champion: str, families: Sequence[str], path: Path) -> Path:
    """Draw how many pairs one estimator is ahead of every other: a row per threshold, a column per family and input.

    Parameters
    ----------
    table : DataFrame
        As from `performance.duel_table`.
    champion : str
        Whom the table is about.
    families : sequence of str
        Which of its families.
    path : Path
        PNG file.
    """
    thresholds, inputs = list(dict.fromkeys(table["threshold_px"])), order_of(table["input"])
    places = [(family, name) for family in families for name in inputs]
    rivals = order_of(table["estimator"])
    size = (2.5 * len(places) + 1.0, (0.25 * len(rivals) + 0.85) * len(thresholds) + 0.3)
    with styled(len(thresholds), len(places), size, sharey=True, sharex=True) as (figure, axes):
        for row, threshold in zip(axes, thresholds, strict=True):
            for axis, (family, name) in zip(row, places, strict=True):
                here = (table["family"] == family) & (table["input"] == name) & (table["threshold_px"] == threshold)
                _differences(axis, table[here].set_index("estimator").loc[rivals])
                if row is axes[0]:
                    axis.set_title(f"{family}\n{INPUT_LOOKS[name].label}")
                if row is axes[-1]:
                    axis.set_xlabel("pairs ahead")
            row[0].set_ylabel(f"below {threshold:g} px", fontweight="bold")
        titles = {"better": f"{champion} is better", "open": "not decided", "worse": f"{champion} is worse"}
        handles = [
            Line2D([], [], color=_VERDICTS[verdict], marker="o", ms=5, mec="white", label=title)
            for verdict, title in titles.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
        return save(figure, path)


def _differences(axis: Axes, part: pd.DataFrame) -> None:
    y = np.arange(len(part))[::-1]
    axis.axvline(0, color=MUTED, lw=0.9, zorder=1)
    for verdict, colour in _VERDICTS.items():
        chosen = (part["verdict"] == verdict).to_numpy()
        at = part[chosen]
        spans = [at["difference"] - at["difference_low"], at["difference_high"] - at["difference"]]
        axis.errorbar(
            at["difference"], y[chosen], xerr=spans, fmt="o", color=colour, ms=5, lw=1.3, mec="white", mew=0.6,
            zorder=3,
        )  # fmt: skip
    axis.set_yticks(y, [str(name) for name in part.index])
    axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
    axis.set_ylim(-0.6, len(part) - 0.4)
