"""Figures of time: what the step costs against what it contributes, and each estimator by outcome."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

from epiprior_lab.evaluation.overhead import correlation
from epiprior_lab.report.study import order_of
from epiprior_lab.report.style import GRID, INK, INPUT_LOOKS, MUTED, SERIES, look_of, save, styled

_DOUBLED = 100  # percent
_CONTRIBUTIONS = (-50, 0, 50, 100, 200, 500, 1000)
_FEW_RUNS = 5
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")


def overhead_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw overhead over contribution: one point per family and estimator, one panel per preset."""
    presets, families = order_of(table["preset"]), order_of(table["family"])
    estimators = order_of(table["estimator"])
    with styled(1, len(presets), (4.6 * len(presets) + 1.2, 3.9), sharey=True) as (figure, axes):
        for axis, preset in zip(axes[0], presets, strict=True):
            part = table[(table["preset"] == preset) & np.isfinite(table["contribution"])]
            # Linear up to a doubling, logarithmic above it: one large contribution must not squeeze all others.
            axis.set_xscale("symlog", linthresh=_DOUBLED, linscale=2)
            for row in part.to_dict("records"):
                axis.scatter(
                    100 * row["contribution"],
                    row["overhead"],
                    s=44,
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
            axis.xaxis.set_major_locator(FixedLocator(_CONTRIBUTIONS))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_locator(NullLocator())
            axis.set(title=f"preset {preset}", xlabel="contribution, %")
        axes[0][0].set(ylabel="time with the step / without", ylim=(0, table["overhead"].max() * 1.25))
        for k, family in enumerate(families):
            axes[0][0].plot([], [], "o", color=SERIES[k % len(SERIES)], label=family)
        for k, estimator in enumerate(estimators):
            axes[0][0].plot([], [], _MARKERS[k % len(_MARKERS)], color=MUTED, label=estimator)
        figure.legend(loc="outside right center")
        return save(figure, path)


def estimator_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw milliseconds per run of each estimator on a logarithmic axis: for successes and for failures.

    Parameters
    ----------
    table : DataFrame
        As from `overhead.estimator_table`; dots are means, with the number of runs beside them, hollow for few.
    path : Path
        PNG file.
    """
    estimators, inputs = order_of(table["estimator"]), [n for n in INPUT_LOOKS if (table["input"] == n).any()]
    with styled(1, 2, (9.6, 0.45 * len(estimators) + 1.3), sharex=True, sharey=True) as (figure, axes):
        for axis, outcome in zip(axes[0], ("success", "failure"), strict=True):
            _seconds(axis, table[table["outcome"] == outcome], estimators, inputs)
            axis.set(
                title=f"runs that end in {outcome}", xlabel="milliseconds per run, matching left out", xscale="log"
            )
            axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        handles = [
            Line2D([], [], ls="", marker=look.marker, color=look.colour, mec="white", ms=7, label=look.label)
            for look in (INPUT_LOOKS[name] for name in inputs)
        ]
        few = f"fewer than {_FEW_RUNS} runs"
        handles.append(Line2D([], [], ls="", marker="o", color=MUTED, mfc="white", mew=1.1, ms=6, label=few))
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
        return save(figure, path)


def _seconds(axis: Axes, part: pd.DataFrame, estimators: list[str], inputs: list[str]) -> None:
    y = np.arange(len(estimators))[::-1]
    for between in y[1:] + 0.5:
        axis.axhline(between, color=GRID, lw=0.8)
    for k, name in enumerate(inputs):
        look = look_of(INPUT_LOOKS, name, k)
        of_input = part[part["input"] == name].set_index("estimator").reindex(estimators)
        mean, runs = 1000 * of_input["mean"], of_input["runs"]
        height = y + 0.17 * ((len(inputs) - 1) / 2 - k)
        few = (runs < _FEW_RUNS).to_numpy()
        axis.plot(mean[~few], height[~few], look.marker, color=look.colour, ms=6, mec="white", mew=0.6)
        axis.plot(mean[few], height[few], look.marker, color=look.colour, ms=5, mfc="white", mew=1.1)
        for at, level, number in zip(mean, height, runs, strict=True):
            if np.isfinite(at):
                axis.annotate(
                    f"{number:.0f}", (at, level), (5, 0), textcoords="offset points", va="center", fontsize=5.5,
                    color=look.colour,
                )  # fmt: skip
    axis.set_yticks(y, estimators)
    axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
    axis.set_ylim(-0.6, len(estimators) - 0.4)
    axis.grid(axis="y", visible=False)
