"""Figures of what comes before the estimators: rankings, roll densities, calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from epiprior_lab.report.study import Study, order_of
from epiprior_lab.report.style import MUTED, RANKING_LOOKS, SERIES, legend, look_of, save, styled
from epiprior_lab.report.tables import STATED, calibration_sums, stated_bins

ROLL_PANELS = 6


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
            upper.set(title=f"preset {preset}", ylim=(0, 1))
            gap, stated = sums.expected_calibration_error, stated_bins(sums).expected_calibration_error
            note = f"Brier {sums.brier_score:.4f}, calibration error {gap:.4f},\n"
            note += f"of matches from {STATED:g} up {stated:.4f}"
            upper.set_title(note, loc="right", fontsize=8, fontweight="normal")
        axes[0][0].set_ylabel("share of right matches")
        axes[1][0].set_ylabel("matches")
        axes[0][0].legend(loc="upper left")
        axes[1][0].legend(loc="upper right")
        return save(figure, path)


def _reliability(axis: Axes, part: pd.DataFrame, label: str, colour: str) -> None:
    sums = calibration_sums(part)
    enough = sums.count >= 20  # the share of a few matches says nothing
    stated = sums.probability[enough] / sums.count[enough]
    axis.plot(stated, sums.right[enough] / sums.count[enough], color=colour, marker="o", ms=3.5, lw=1.4, label=label)
