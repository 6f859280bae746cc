"""Figure of the classifiers: honest folds by scene beside the ungrouped folds of the paper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from epiprior_lab.report.study import order_of
from epiprior_lab.report.style import save, styled

METRIC_NAMES = {
    "precision_top_100": "precision of the top 100",
    "average_precision": "average precision",
    "accuracy": "accuracy",
    "precision": "precision",
    "log_loss": "log loss",
    "brier_score": "Brier score",
    "expected_calibration_error": "calibration error",
}
TARGET_NAMES = {"two_keypoint": "2keypoint matches", "match": "matches"}
DRAWN = ("precision_top_100", "average_precision", "accuracy", "precision")


def classifier_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw metrics of each family of classifiers, grouped by scene and not: a row per preset and target.

    Parameters
    ----------
    table : DataFrame
        As from `tables.classifier_table`.
    path : Path
        PNG file.
    """
    subjects = list(dict.fromkeys(zip(table["preset"], table["target"], strict=True)))
    metrics = [name for name in DRAWN if (table["metric"] == name).any()]
    rows, columns = len(subjects), len(metrics)
    with styled(rows, columns, (2.7 * columns, 1.7 * rows + 0.6), sharex=True, sharey=False) as (
        figure,
        axes,
    ):
        for row, (preset, target) in zip(axes, subjects, strict=True):
            for axis, metric in zip(row, metrics, strict=True):
                chosen = (table["preset"] == preset) & (table["target"] == target)
                _bars(axis, table[chosen & (table["metric"] == metric)])
                if row is axes[0]:
                    axis.set_title(METRIC_NAMES[metric])
                axis.tick_params(labelleft=axis is row[0])
            row[0].set_ylabel(f"{preset}:\n{TARGET_NAMES.get(str(target), str(target))}", fontweight="bold")
        axes[0][0].set_xlim(0, 1)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        return save(figure, path)


def _bars(axis: Axes, part: pd.DataFrame) -> None:
    families = order_of(part["family"])
    y = np.arange(len(families))[::-1]
    values = part.set_index("family").loc[families]
    both = values["ungrouped"].notna().to_numpy()
    for offset, name, colour, label in (
        (np.where(both, 0.2, 0.0), "grouped", "#0072b2", "folds by scene"),
        (
            np.full(len(families), -0.2),
            "ungrouped",
            "#e3a76f",
            "folds by row, as in the paper: leaks (exported family)",
        ),
    ):
        width = values[name].to_numpy(np.float64)
        axis.barh(y + offset, width, 0.36, color=colour, label=label)
        deviation = values[f"{name}_sd"].fillna(0.0).to_numpy(np.float64)
        axis.errorbar(width, y + offset, xerr=deviation, fmt="none", ecolor="#2b2f36", elinewidth=0.8)
    axis.set_yticks(y, families)
    axis.grid(axis="y", visible=False)
