"""Tables of the report beside successes: rankings, calibration, classifiers, estimators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.estimators import find_estimator
from epiprior_lab.evaluation.estimates import is_deterministic
from epiprior_lab.evaluation.statistics import CalibrationBins
from epiprior_lab.report.performance import ALL
from epiprior_lab.report.study import Study, order_of

ENOUGH_RIGHT = 15  # right matches from which an F can be found, if the order is good
STATED = 0.05  # an edge of the bins; nearly all matches are below, and decide the error over all


def ranking_table(study: Study) -> pd.DataFrame:
    """Return means over pairs per preset, family (``all`` last) and ranking.

    Returns
    -------
    DataFrame
        ``matches``, ``right``, precision at 10, 100 and 500, and ``average_precision``; ``enough``, the share of pairs
        with at least `ENOUGH_RIGHT` right matches.
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
                enough = float((part["right"] >= ENOUGH_RIGHT).mean())
                rows.append({"preset": preset, "family": family, "ranking": ranking, **means, "enough": enough})
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


def stated_bins(sums: CalibrationBins) -> CalibrationBins:
    """Return the bins whose matches state a probability of `STATED` or more."""
    bins = len(sums.count)
    kept = np.arange(bins) >= round(STATED * bins)
    return CalibrationBins(
        count=sums.count[kept],
        right=sums.right[kept],
        probability=sums.probability[kept],
        squared_error=sums.squared_error[kept],
    )


def calibration_table(study: Study) -> pd.DataFrame:
    """Return the calibration per preset and family (``all`` last).

    Returns
    -------
    DataFrame
        ``preset, family``; ``matches`` and ``right`` ones among them, ``brier_score`` and
        ``expected_calibration_error``; ``stated_matches``, those with a probability of `STATED` or more, and their
        ``stated_calibration_error``.
    """
    rows = []
    for preset in order_of(study.calibration["preset"]):
        for family in (*study.families, ALL):
            part = study.calibration[study.calibration["preset"] == preset]
            sums = calibration_sums(part if family == ALL else part[part["family"] == family])
            stated = stated_bins(sums)
            rows.append(
                {
                    "preset": preset,
                    "family": family,
                    "matches": int(sums.count.sum()),
                    "right": int(sums.right.sum()),
                    "brier_score": sums.brier_score,
                    "expected_calibration_error": sums.expected_calibration_error,
                    "stated_matches": int(stated.count.sum()),
                    "stated_calibration_error": stated.expected_calibration_error,
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


def estimator_table(estimators: Sequence[str]) -> pd.DataFrame:
    """Return what stands behind each name: ``estimator, backend, max_iterations, deterministic``.

    ``max_iterations`` caps the samples of a run, per roll hypothesis; slow estimators have lower caps. For `epiprior`
    it caps the progressive samples alone: rough matrices and pairs of oriented matches give further hypotheses.
    """
    rows = []
    for name in estimators:
        found = find_estimator(name)
        rows.append(
            {
                "estimator": name,
                "backend": found.version(),
                "max_iterations": found.max_iterations,
                "deterministic": is_deterministic(name),
            }
        )
    return pd.DataFrame(rows)


def write_table(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as CSV with six significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")
    return path
