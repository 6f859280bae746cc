"""Figures of the report on photographs; they show numbers, never photographs, and so may be passed on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.features.matching import INPUTS, WITHOUT
from epiprior_lab.report.figures import calibration_figure
from epiprior_lab.report.performance import COLUMNS
from epiprior_lab.report.photographs.results import ALL, Photographs
from epiprior_lab.report.study import Study, order_of
from epiprior_lab.report.style import INPUT_LOOKS, legend, look_of, save, styled
from epiprior_lab.report.success_figures import performance_figure, success_figure

MIN_BAR = 30  # a share of fewer runs says little


def draw_figures(
    photographs: Photographs, successes: pd.DataFrame, at: Path, *, thresholds_px: Sequence[float]
) -> dict[str, Path]:
    """Draw all figures.

    Parameters
    ----------
    photographs : Photographs
        Results.
    successes : DataFrame
        As from `tables.success_table`.
    at : Path
        Folder.
    thresholds_px : sequence of float
        Rows of the figure of successes.

    Returns
    -------
    dict of str to Path
        By the names that the page uses; what nothing was measured for is left out.
    """
    study = as_study(photographs)
    splits = [name for name in photographs.groups if name in SPLITS]
    drawn: dict[str, Path] = {}
    if splits:
        wide = as_performance(successes[successes["threshold_px"].isin(list(thresholds_px))])
        drawn["successes"] = performance_figure(wide[wide["family"].isin(splits)], at / "successes.png")
        drawn["curves"] = success_figure(study, at / "curves.png")
        drawn["rankings"] = ranking_figure(photographs, at / "rankings.png")
    if len(study.calibration):
        drawn["calibration"] = calibration_figure(study, at / "calibration.png")
    return drawn


def as_study(photographs: Photographs) -> Study:
    """Return the pairs that count as a study whose families are the splits, for the figures of the study."""
    counted = photographs.counted

    def families(table: pd.DataFrame) -> pd.DataFrame:
        part = table[table["pair"].isin(counted) & table["split"].isin(SPLITS)]
        return part.assign(family=part["split"], pair_id=part["pair"])

    empty = pd.DataFrame()
    own = photographs.results["input"].isin(INPUTS)  # peers would be too much for one panel
    return Study(
        results=families(photographs.results[own]),
        rankings=empty,
        ranking_curves=empty,
        roll=empty,
        calibration=families(photographs.calibration),
        hand_over=empty,
        classifiers=empty,
        families=tuple(name for name in photographs.groups if name in SPLITS),
    )


def as_performance(successes: pd.DataFrame) -> pd.DataFrame:
    """Return successes with one column per input, as the figure and the tables of the study want them."""
    rows = []
    for (threshold, group, estimator), part in successes.groupby(["threshold_px", "group", "estimator"], sort=False):
        row = {"threshold_px": threshold, "family": group, "estimator": estimator, "pairs": part["pairs"].iloc[0]}
        row |= dict.fromkeys([*COLUMNS, *(f"{name}_sd" for name in COLUMNS)], np.nan)
        for found in part.to_dict("records"):
            column = "without" if found["input"] in WITHOUT else found["input"]
            row |= {column: found["successes"], f"{column}_sd": found["successes_sd"]}
        rows.append(row)
    return pd.DataFrame(rows)


def ranking_figure(photographs: Photographs, path: Path) -> Path:
    """Draw cumulative precision over the rank, mean over pairs: a panel per split, and one for all."""
    curves = photographs.ranking_curves
    curves = curves.assign(precision=curves["right"] / curves["rank"])
    groups = [name for name in photographs.groups if name in (*SPLITS, ALL)]
    names = order_of(curves["ranking"])
    looks = {name: look_of(INPUT_LOOKS, name, k) for k, name in enumerate(names)}
    with styled(1, len(groups), (2.75 * len(groups), 2.9), sharex=True, sharey=True) as (figure, axes):
        for axis, group in zip(axes[0], groups, strict=True):
            pairs = set(photographs.pairs["pair"][photographs.groups[group]])
            part = curves[curves["pair"].isin(pairs)]
            means = part.groupby(["ranking", "rank"], sort=True)["precision"].mean()
            for name, look in looks.items():
                axis.plot(means.loc[name].index, means.loc[name], color=look.colour, ls=look.line)
            axis.set(xscale="log", ylim=(0, 1.02), xlim=(1, 10_000), xlabel="matches, best first")
            axis.set_xticks([1, 10, 100, 1000, 10_000], ["1", "10", "100", "1,000", "10,000"])
            axis.set_title(f"{group} ({part['pair'].nunique()})")
        axes[0][0].set_ylabel("share of right matches")
        legend(figure, looks, names)
        return save(figure, path)


def enough_runs(verdicts: pd.DataFrame) -> pd.DataFrame:
    """Return verdicts for the figure: no bar where a share would be of fewer than `MIN_BAR` runs."""
    shown = verdicts.copy()
    for kind in ("right", "wrong"):
        few = shown[kind] < MIN_BAR
        shown.loc[few, [kind, f"{kind}_no_model", f"{kind}_degenerate"]] = 0
    return shown
