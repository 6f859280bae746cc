"""Tables of the report: the paper's Table 2 with intervals, rankings, and classifiers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.reports.study import Study, errors_of, order_of, success_rates
from epiprior_lab.seeds import child_seed
from epiprior_lab.statistics import CalibrationBins, Interval, paired_bootstrap, success_curve

ALL = "all"
COMPARISONS = (("standard", "paper"), ("standard", "default"), ("snn", "default"))


def performance_table(study: Study, *, thresholds_px: Sequence[float], draws: int, seed: int) -> pd.DataFrame:
    """Return successes per family and estimator, without and with the preprocessing step.

    Parameters
    ----------
    study : Study
        Results.
    thresholds_px : sequence of float
        Thresholds of success, pixels.
    draws, seed : int
        Of the bootstrap, which draws whole scenes.

    Returns
    -------
    DataFrame
        One row per threshold, family (``all`` last) and estimator: ``pairs``; for each input the number of
        successful pairs in the mean over seeds and its deviation ``<input>_sd``; for each of `COMPARISONS`
        the contribution ``<with>_over_<without>`` with the ends of its 95 % interval, ``_low`` and
        ``_high``, as shares, and the difference in pairs ``<with>_minus_<without>``, likewise.
    """
    rows = []
    inputs = order_of(study.results["input"])
    for threshold in thresholds_px:
        for family in (*study.families, ALL):
            chosen = study.results if family == ALL else study.results[study.results["family"] == family]
            for estimator in order_of(study.results["estimator"]):
                results = chosen[chosen["estimator"] == estimator]
                row: dict[str, Any] = {"threshold_px": threshold, "family": family, "estimator": estimator}
                row["pairs"] = results["pair_id"].nunique()
                for name in inputs:
                    mean, deviation = success_curve(errors_of(results, input=name).to_numpy(), [threshold])
                    row[name], row[f"{name}_sd"] = float(mean[0]), float(deviation[0])
                child = child_seed(seed, family, estimator, str(threshold))
                rows.append(row | _comparisons(results, inputs, threshold, draws, child))
    return pd.DataFrame(rows)


def _comparisons(
    results: pd.DataFrame, inputs: Sequence[str], threshold: float, draws: int, seed: int
) -> dict[str, float]:
    cells: dict[str, float] = {}
    for without, with_step in COMPARISONS:
        if without not in inputs or with_step not in inputs:
            continue
        a, scenes = success_rates(results, threshold, input=without)
        b, _ = success_rates(results, threshold, input=with_step)
        got = paired_bootstrap(a, b, draws=draws, seed=seed, groups=scenes)
        cells |= _cells(f"{with_step}_over_{without}", got.contribution, 1.0)
        cells |= _cells(f"{with_step}_minus_{without}", got.difference, float(len(a)))
    return cells


def _cells(name: str, interval: Interval, factor: float) -> dict[str, float]:
    return {
        name: interval.value * factor,
        f"{name}_low": interval.low * factor,
        f"{name}_high": interval.high * factor,
    }


def ranking_table(study: Study) -> pd.DataFrame:
    """Return means over pairs per preset, family (``all`` last) and ranking.

    Returns
    -------
    DataFrame
        ``matches``, ``right``, precision at 10, 100 and 500, and ``average_precision``.
    """
    measures = ["matches", "right", "precision_10", "precision_100", "precision_500", "average_precision"]
    rows = []
    for preset in order_of(study.rankings["preset"]):
        for family in (*study.families, ALL):
            for ranking in order_of(study.rankings["ranking"]):
                part = study.rankings
                part = part[(part["preset"] == preset) & (part["ranking"] == ranking)]
                part = part if family == ALL else part[part["family"] == family]
                means = {name: float(part[name].mean()) for name in measures}
                rows.append({"preset": preset, "family": family, "ranking": ranking, **means})
    return pd.DataFrame(rows)


def calibration_sums(calibration: pd.DataFrame) -> CalibrationBins:
    """Return the sums over all pairs of the rows, bin by bin."""
    sums = calibration.groupby("bin", sort=True)[["count", "right", "probability", "squared_error"]].sum()
    return CalibrationBins(
        count=sums["count"].to_numpy(np.int64),
        right=sums["right"].to_numpy(np.int64),
        probability=sums["probability"].to_numpy(np.float64),
        squared_error=sums["squared_error"].to_numpy(np.float64),
    )


def calibration_table(study: Study) -> pd.DataFrame:
    """Return Brier score and expected calibration error per preset and family (``all`` last)."""
    rows = []
    for preset in order_of(study.calibration["preset"]):
        for family in (*study.families, ALL):
            part = study.calibration[study.calibration["preset"] == preset]
            sums = calibration_sums(part if family == ALL else part[part["family"] == family])
            rows.append(
                {
                    "preset": preset,
                    "family": family,
                    "matches": int(sums.count.sum()),
                    "right": int(sums.right.sum()),
                    "brier_score": sums.brier_score,
                    "expected_calibration_error": sums.expected_calibration_error,
                }
            )
    return pd.DataFrame(rows)


def classifier_table(study: Study) -> pd.DataFrame:
    """Return each metric of each classifier, grouped by scene and not.

    Returns
    -------
    DataFrame
        ``preset, target, family, metric``, then over all rows ``grouped``, ``ungrouped`` and ``calibrated``
        (grouped, after calibration; NaN where nothing was calibrated), and deviations over folds
        ``grouped_sd`` and ``ungrouped_sd`` (NaN where folds have no such metric).
    """
    table = study.classifiers.assign(fold=study.classifiers["fold"].astype(str))
    table = table.assign(grouped=table["grouped"].astype(str).str.lower().isin(["true", "1"]))
    rows = []
    for key, part in table.groupby(["preset", "target", "family", "metric"], sort=False):
        row: dict[str, Any] = dict(zip(("preset", "target", "family", "metric"), key, strict=True))
        for name, flag in (("grouped", True), ("ungrouped", False)):
            values = part[part["grouped"] == flag].set_index("fold")["value"]
            folds = values[values.index.str.isdecimal()].dropna()
            row[name] = float(values.get("all", np.nan))
            row[f"{name}_sd"] = float(folds.std(ddof=1)) if len(folds) > 1 else np.nan
            if flag:
                row["calibrated"] = float(values.get("calibrated", np.nan))
        rows.append(row)
    return pd.DataFrame(rows)


def write_table(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as CSV with six significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")
    return path


def percent(value: float) -> str:
    """Return a share as a signed percentage: ``+44.8 %``, or ``new`` where nothing succeeded without."""
    if np.isinf(value):
        return "new"
    return f"{100 * value:+.0f} %" if round(100 * value) else "0 %"


def performance_markdown(table: pd.DataFrame) -> str:
    """Return the performance table as text for a reader, in the shape of the paper's Table 2.

    Parameters
    ----------
    table : DataFrame
        As from `performance_table`.
    """
    lines = [
        "# Successes without and with the preprocessing step",
        "",
        "Number of test pairs whose error (mean over control points of the root of the Sampson distance) is",
        "below the threshold: mean over seeds ± one standard deviation. The contribution is",
        "(with - without) / without, as in the paper, with a 95 % bootstrap interval over scenes; `new`",
        "where nothing succeeded without. `standard`: X_L of the paper. `snn`: RootSIFT, mutual nearest",
        "neighbours, ratio test. `paper`: the method as printed. `default`: the method with our",
        "improvements. Every input is handed over in the way that did best on validation scenes.",
    ]
    for threshold, at in table.groupby("threshold_px", sort=False):
        lines += ["", f"## Below {threshold:g} px"]
        for family, part in at.groupby("family", sort=False):
            title = "All families" if family == ALL else str(family)
            lines += ["", f"### {title} ({part['pairs'].max()} pairs)", "", *_markdown_rows(part)]
    return "\n".join(lines) + "\n"


def _markdown_rows(part: pd.DataFrame) -> list[str]:
    inputs = [name for name in ("standard", "snn", "paper", "default") if name in part.columns]
    pairs = [(a, b) for a, b in COMPARISONS if f"{b}_over_{a}" in part.columns]
    head = ["estimator", *(f"`{name}`" for name in inputs), *(f"`{b}` over `{a}`" for a, b in pairs)]
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    for row in part.to_dict("records"):
        cells = [f"{row[name]:.1f} ± {row[f'{name}_sd']:.1f}" for name in inputs]
        cells += [contribution_cell(row, f"{b}_over_{a}") for a, b in pairs]
        lines.append(f"| {row['estimator']} | " + " | ".join(cells) + " |")
    return lines


def contribution_cell(row: dict[Any, Any], name: str) -> str:
    """Return ``+45 % [+12 %, +90 %]`` of the columns `name`, `name`_low and `name`_high."""
    return f"{percent(row[name])} [{percent(row[f'{name}_low'])}, {percent(row[f'{name}_high'])}]"
