"""Figures of the evaluation: successes, rankings, roll densities, calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from epiprior_lab.reports.study import Study, errors_of, order_of
from epiprior_lab.reports.style import (
    GRID,
    INK,
    INPUT_LOOKS,
    MUTED,
    RANKING_LOOKS,
    SERIES,
    legend,
    look_of,
    save,
    styled,
)
from epiprior_lab.reports.tables import ALL, calibration_sums
from epiprior_lab.statistics import success_curve

CURVE_LIMIT_PX = 20.0
ROLL_PANELS = 6


def performance_figure(table: pd.DataFrame, threshold_px: float, path: Path) -> Path:
    """Draw successes per family and estimator, one dot per input: the performance table at a glance.

    Parameters
    ----------
    table : DataFrame
        As from `tables.performance_table`.
    threshold_px : float
        Which of its thresholds.
    path : Path
        PNG file.
    """
    at = table[(table["threshold_px"] == threshold_px) & (table["family"] != ALL)]
    families, inputs = order_of(at["family"]), [n for n in INPUT_LOOKS if n in at.columns]
    with styled(1, len(families), (2.75 * len(families), 3.2), sharey=True) as (figure, axes):
        for axis, family in zip(axes[0], families, strict=True):
            part = at[at["family"] == family]
            pairs = int(part["pairs"].max())
            y = np.arange(len(part))[::-1]
            for between in y[1:] + 0.5:
                axis.axhline(between, color=GRID, lw=0.8)
            for k, name in enumerate(inputs):
                look = INPUT_LOOKS[name]
                height = y + 0.13 * ((len(inputs) - 1) / 2 - k)  # equal numbers must not hide each other
                axis.errorbar(
                    part[name], height, xerr=part[f"{name}_sd"], fmt=look.marker, color=look.colour,
                    ms=7 if name == "default" else 5.5, lw=1.1, mec="white", mew=0.7, zorder=3,
                    label=look.label,
                )  # fmt: skip
            axis.set(title=family, xlim=(-0.03 * pairs, 1.03 * pairs), ylim=(-0.6, len(part) - 0.4))
            axis.set_yticks(y, list(part["estimator"]))
            axis.tick_params(axis="y", labelsize=9, labelcolor=INK)
            axis.grid(axis="y", visible=False)
            axis.set_xlabel(f"pairs of {pairs} below {threshold_px:g} px")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        return save(figure, path)


def success_figure(study: Study, path: Path, limit_px: float = CURVE_LIMIT_PX) -> Path:
    """Draw successful pairs over the threshold: a row per family, a column per estimator.

    Bars are one standard deviation over seeds, as in the paper's figure of results.
    """
    estimators, inputs = order_of(study.results["estimator"]), order_of(study.results["input"])
    grid = np.linspace(0, limit_px, 201)
    bars = np.arange(2.5, limit_px, 2.5)
    rows, columns = len(study.families), len(estimators)
    with styled(rows, columns, (2.6 * columns, 2.05 * rows + 0.5), sharex=True) as (figure, axes):
        for row, family in zip(axes, study.families, strict=True):
            of_family = study.results[study.results["family"] == family]
            pairs = of_family["pair_id"].nunique()
            for axis, estimator in zip(row, estimators, strict=True):
                for k, name in enumerate(inputs):
                    errors = errors_of(of_family, estimator=estimator, input=name).to_numpy()
                    look = look_of(INPUT_LOOKS, name, k)
                    axis.plot(grid, success_curve(errors, grid)[0], color=look.colour, ls=look.line, lw=1.6)
                    at = bars + 0.22 * (k - (len(inputs) - 1) / 2)  # side by side, so that bars do not hide bars
                    mean, deviation = success_curve(errors, at)
                    axis.errorbar(at, mean, deviation, fmt="none", ecolor=look.colour, elinewidth=0.9, alpha=0.8)
                axis.axvline(10, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
                axis.set(xlim=(0, limit_px), ylim=(0, pairs * 1.02))
                if row is axes[0]:
                    axis.set_title(estimator)
                if row is axes[-1]:
                    axis.set_xlabel("threshold, px")
                axis.tick_params(labelleft=axis is row[0])
            row[0].set_ylabel(f"{family}\nsuccessful pairs", fontweight="bold")
        legend(figure, INPUT_LOOKS, [n for n in inputs if n in INPUT_LOOKS])
        return save(figure, path)


def ranking_figure(study: Study, path: Path) -> Path:
    """Draw cumulative precision over the rank, mean over pairs: a row per preset, a column per family."""
    curves = study.ranking_curves
    presets, rankings = order_of(curves["preset"]), order_of(curves["ranking"])
    curves = curves.assign(precision=curves["right"] / curves["rank"])
    means = curves.groupby(["preset", "family", "ranking", "rank"], sort=True)["precision"].mean()
    rows, columns = len(presets), len(study.families)
    with styled(rows, columns, (2.75 * columns, 2.3 * rows + 0.6), sharex=True, sharey=True) as (
        figure,
        axes,
    ):
        for row, preset in zip(axes, presets, strict=True):
            for axis, family in zip(row, study.families, strict=True):
                for k, ranking in enumerate(rankings):
                    curve = means.loc[(preset, family, ranking)]
                    look = look_of(RANKING_LOOKS, ranking, k)
                    axis.plot(curve.index, curve, color=look.colour, ls=look.line)
                axis.set(xscale="log", ylim=(0, 1.02), xlim=(1, 10_000))
                axis.set_xticks([1, 10, 100, 1000, 10_000], ["1", "10", "100", "1,000", "10,000"])
                if row is axes[0]:
                    axis.set_title(family)
                if row is axes[-1]:
                    axis.set_xlabel("matches, best first")
            row[0].set_ylabel(f"preset {preset}\nshare of right matches", fontweight="bold")
        legend(figure, RANKING_LOOKS, [n for n in rankings if n in RANKING_LOOKS])
        return save(figure, path)


def roll_figure(study: Study, path: Path, panels: int = ROLL_PANELS) -> Path:
    """Draw the density of the roll for the pairs with the largest true roll, on a full turn."""
    first = study.roll.drop_duplicates("pair_id").set_index("pair_id")
    turn = first["true_roll_deg"].abs().round(6).sort_values(ascending=False, kind="stable")
    step = max(1, len(turn[turn > 20]) // panels)  # from half a turn down to slight ones
    chosen = list(turn.index[: step * panels : step])
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    with styled(rows, columns, (3.4 * columns, 2.1 * rows + 0.4)) as (figure, axes):
        flat = [axis for row in axes for axis in row]
        for axis, pair_id in zip(flat, chosen, strict=False):
            part = study.roll[study.roll["pair_id"] == pair_id]
            _roll_panel(axis, part)
            axis.set_title(str(pair_id))
        for axis in flat[len(chosen) :]:
            axis.set_visible(False)
        for axis in axes[-1]:
            axis.set_xlabel("roll of image 2 against image 1, degrees")
        for row in axes:
            row[0].set_ylabel("density, 1/degree")
        handles, labels = flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        return save(figure, path)


def _roll_panel(axis: Axes, part: pd.DataFrame) -> None:
    # Angles are shown from -180 to 180 degrees, where 0 is the middle.
    angle = (part["angle_deg"].to_numpy() + 180) % 360 - 180
    order = np.argsort(angle, kind="stable")
    density = part["density"].to_numpy()[order]
    axis.fill_between(angle[order], density, color="#0072b2", alpha=0.18, lw=0)
    axis.plot(angle[order], density, color="#0072b2", label="density over X_L and X_B")
    true = float(part["true_roll_deg"].iloc[0])
    if np.isfinite(true):
        axis.axvline(true, color="#d55e00", ls=(0, (4, 2)), lw=1.5, label="true roll, from the cameras")
    axis.set(xlim=(-180, 180), ylim=(0, None))
    axis.set_xticks([-180, -90, 0, 90, 180])


def calibration_figure(study: Study, path: Path) -> Path:
    """Draw, per preset, the share of right matches over the stated probability, and how many state it."""
    presets = order_of(study.calibration["preset"])
    with styled(2, len(presets), (4.2 * len(presets), 5.2), sharex=True) as (figure, axes):
        for k, preset in enumerate(presets):
            of_preset = study.calibration[study.calibration["preset"] == preset]
            upper, lower = axes[0][k], axes[1][k]
            upper.plot([0, 1], [0, 1], color=MUTED, lw=1, ls=(0, (2, 2)))
            for i, family in enumerate(study.families):
                _reliability(upper, of_preset[of_preset["family"] == family], family, SERIES[i % len(SERIES)])
            sums = calibration_sums(of_preset)
            width = 1 / len(sums.count)
            place = (np.arange(len(sums.count)) + 0.5) * width
            lower.bar(place, sums.count, width * 0.92, color="#c9ced6", label="matches")
            lower.bar(place, sums.right, width * 0.92, color="#0072b2", label="right matches")
            lower.set(yscale="log", xlim=(0, 1), xlabel="stated probability")
            brier, gap = sums.brier_score, sums.expected_calibration_error
            upper.set(title=f"preset {preset}", ylim=(0, 1))
            note = f"Brier {brier:.4f}, calibration error {gap:.4f}"
            upper.set_title(note, loc="right", fontsize=8, fontweight="normal")
        axes[0][0].set_ylabel("share of right matches")
        axes[1][0].set_ylabel("matches of all test pairs")
        axes[0][0].legend(loc="upper left")
        axes[1][0].legend(loc="upper right")
        return save(figure, path)


def _reliability(axis: Axes, part: pd.DataFrame, label: str, colour: str) -> None:
    sums = calibration_sums(part)
    enough = sums.count >= 20  # the share of a few matches says nothing
    stated = sums.probability[enough] / sums.count[enough]
    axis.plot(stated, sums.right[enough] / sums.count[enough], color=colour, marker="o", ms=3.5, lw=1.4, label=label)


def hand_over_figure(study: Study, path: Path) -> Path:
    """Draw the search on validation scenes: a row per estimator, a column per setting, a line per input."""
    settings = [s for s in _SETTING_NAMES if (study.hand_over["step"] == s).any()]
    estimators = order_of(study.hand_over["estimator"])
    rows, columns = len(estimators), len(settings)
    with styled(rows, columns, (2.1 * columns + 0.6, 1.8 * rows + 0.5), sharey=True) as (figure, axes):
        for row, estimator in zip(axes, estimators, strict=True):
            for axis, setting in zip(row, settings, strict=True):
                part = study.hand_over[study.hand_over["estimator"] == estimator]
                _sweep_panel(axis, part, setting)
                if row is axes[0]:
                    axis.set_title(_SETTING_NAMES[setting])
            row[0].set_ylabel(f"{estimator}\npairs below 10 px", fontweight="bold")
        legend(figure, INPUT_LOOKS, [n for n in INPUT_LOOKS if n in set(study.hand_over["input"])])
        return save(figure, path)


_SETTING_NAMES = {
    "max_distance_ratio": "distance ratio, at most",
    "top_k": "best matches, at most",
    "min_probability": "probability, at least",
    "threshold_px": "threshold, px",
    "spread": "share per grid cell",
    "refine": "refined",
    "collect": "support collected",
    "one_to_one": "one-to-one",
}


def _sweep_panel(axis: Axes, part: pd.DataFrame, setting: str) -> None:
    """Draw the trials of one setting, and the best trial before it, from which they vary."""
    lines = []
    for k, name in enumerate(order_of(part["input"])):
        of_input = part[part["input"] == name]
        varied = of_input[of_input["step"] == setting]
        if varied.empty:
            continue
        before = of_input.loc[: varied.index[0]].iloc[:-1]
        score = ["successes_10", "successes_3", "area"]
        trials = pd.concat([varied, before.sort_values(score, kind="stable").tail(1)])
        lines.append((look_of(INPUT_LOOKS, name, k), trials))
    if not lines:
        axis.set_axis_off()
        return
    levels = _levels(setting, pd.concat([trials[setting] for _, trials in lines]))
    for look, trials in lines:
        x = np.array([levels.index(_level(value)) for value in trials[setting]])
        order = np.argsort(x, kind="stable")
        y = trials["successes_10"].to_numpy()
        axis.plot(x[order], y[order], color=look.colour, ls=look.line, marker=look.marker, ms=4, lw=1.3)
    axis.set_xticks(range(len(levels)), levels)
    axis.set_xlim(-0.4, len(levels) - 0.6)


def _level(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return "none" if pd.isna(value) else f"{float(value):g}"


def _levels(setting: str, values: pd.Series[Any]) -> list[str]:
    """Return the different values from strict to loose: no limit comes last, no floor comes first."""
    different = {_level(value): value for value in values}
    none = -np.inf if setting == "min_probability" else np.inf
    return sorted(different, key=lambda text: none if text == "none" else float(different[text]))
