"""What MLflow is told of a comparison: a run per family, and the model of the exported one."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from sklearn.metrics import precision_recall_curve

from epiprior_lab.measures import calibration_bins
from epiprior_lab.tracking import Run
from epiprior_lab.training.comparison import Comparison

_EXAMPLE_ROWS = 5
_CURVE_POINTS = 500


def tracked_runs(comparison: Comparison, settings: Mapping[str, Any]) -> list[Run]:
    """Return a run per family of one comparison; `settings` are the parameters of the training."""
    data = comparison.data
    described = {**settings, "rows": len(data.rows), "pairs": len(data.pairs), "columns": ", ".join(data.columns)}
    described["data_sha256"] = data.digest()
    return [_run(comparison, family, described) for family in comparison.grouped]


def _run(comparison: Comparison, family: str, parameters: Mapping[str, Any]) -> Run:
    data, grouped = comparison.data, comparison.grouped[family]
    exported = family == comparison.exported
    seconds = grouped.seconds_per_10000_rows
    metrics = {**grouped.metrics, "seconds_per_10000_rows": sum(seconds) / len(seconds)}
    metrics |= {f"{key}.deviation": value for key, value in grouped.deviations().items()}
    metrics |= {f"calibrated.{key}": value for key, value in grouped.calibrated_metrics.items()}
    times = ({"seconds_per_10000_rows": time} for time in seconds)
    folds = [{**fold, **time} for fold, time in zip(grouped.fold_metrics, times, strict=True)]
    curves = {"grouped by scene": grouped.probability}
    if exported:
        metrics |= {f"ungrouped.{key}": value for key, value in comparison.ungrouped.metrics.items()}
        curves["ungrouped"] = comparison.ungrouped.probability

    precision_recall, axes = _figure("recall", "precision")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    for label, probability in curves.items():
        precision, recall, _ = precision_recall_curve(data.labels, probability)
        step = max(1, len(precision) // _CURVE_POINTS)
        axes.plot(recall[::step], precision[::step], label=label)
    axes.legend()
    reliability, axes = _figure("predicted probability", "share of right ones")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    axes.plot(*calibration_bins(grouped.probability, data.labels).curve[:, :2].T, marker="o")
    figures = {"precision_recall.png": precision_recall, "reliability.png": reliability}
    if exported and comparison.refit.importances is not None:
        importances, axes = _figure("importance", "")
        importances.set_figheight(0.3 * len(data.columns) + 1)
        order = np.argsort(comparison.refit.importances)
        axes.barh([data.columns[i] for i in order], comparison.refit.importances[order])
        figures["importances.png"] = importances
    onnx = comparison.refit.onnx if exported else None
    return Run(
        experiment=data.target,
        name=f"{comparison.preset}-{family}",
        tags={"preset": comparison.preset, "target": data.target, "family": family, "exported": str(exported).lower()},
        parameters=parameters,
        metrics=metrics,
        folds=folds,
        figures=figures,
        onnx=onnx,
        rows=data.rows[:_EXAMPLE_ROWS],
    )


def _figure(x: str, y: str) -> tuple[Figure, Any]:
    figure = Figure(figsize=(5, 4), layout="constrained")
    return figure, figure.add_subplot(xlabel=x, ylabel=y)
