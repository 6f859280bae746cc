"""What training leaves behind: measures, curves and importances of all families, and two classifiers."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.training.calibration import reliability
from epiprior_lab.training.classifiers import Comparison
from epiprior_lab.training.metrics import METRICS, precision_recall
from epiprior_lab.training.model_training import PresetTraining

_CURVE_POINTS = 200


def write_training(folder: Path, trained: PresetTraining) -> None:
    """Write the results of training; the same results give the same bytes.

    Parameters
    ----------
    folder : Path
        Made if absent. It gets ``metrics.csv``, ``curves.csv``, ``importances.csv``, both classifiers of the
        exported family as ``<target>.onnx``, ``parity.npz`` with rows and the classifiers' own probabilities
        of them, and ``summary.json`` with all that a manifest says of them.
    trained : PresetTraining
        Results.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in (("metrics", metrics_csv), ("curves", curves_csv), ("importances", importances_csv)):
        (folder / f"{name}.csv").write_text(table(trained.comparisons), encoding="utf-8")
    summary: dict[str, Any] = {"training_data": _training_data(trained)}
    parity: dict[str, Any] = {}
    for comparison in trained.comparisons:
        target = comparison.data.target
        refit, platt = comparison.refits[trained.family], comparison.calibration(trained.family)
        (folder / f"{target}.onnx").write_bytes(refit.onnx)
        parity[f"{target}_rows"] = refit.parity_rows
        parity[f"{target}_probability"] = refit.parity_probability
        summary[target] = {
            "family": trained.family,
            "columns": list(comparison.data.columns),
            "a": platt.a,
            "b": platt.b,
            "metrics": card_metrics(comparison, trained.family),
        }
    np.savez(folder / "parity.npz", **parity)
    text = json.dumps(summary, indent=2, sort_keys=True, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def _training_data(trained: PresetTraining) -> dict[str, Any]:
    """Return counts and the hash of all rows and labels."""
    first, second = (comparison.data for comparison in trained.comparisons)
    return {
        "sha256": hashlib.sha256((first.digest() + second.digest()).encode()).hexdigest(),
        "scenes": len(np.unique(first.scene)),
        "rankings": len(first.share),
        **{f"{data.target}_rows": len(data.rows) for data in (first, second)},
        **{f"{data.target}_right": int(data.labels.sum()) for data in (first, second)},
    }


def metrics_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, grouped, fold, metric, value.

    The fold is a number, ``all``, ``deviation`` or ``calibrated``. Measures that are not defined have no row.
    """
    lines: list[Sequence[Any]] = [("target", "family", "grouped", "fold", "metric", "value")]
    for comparison in comparisons:
        for grouped, items in ((True, comparison.grouped), (False, comparison.ungrouped)):
            for family in sorted(items):
                item = items[family]
                tables = {str(number): metrics for number, metrics in enumerate(item.fold_metrics)}
                tables |= {"all": item.metrics, "deviation": item.deviations()}
                tables["calibrated"] = item.calibrated_metrics
                lines += [
                    (
                        comparison.data.target,
                        family,
                        str(grouped).lower(),
                        fold,
                        name,
                        repr(float(table[name])),
                    )
                    for fold, table in tables.items()
                    for name in METRICS
                    if np.isfinite(table.get(name, np.nan))
                ]
    return _csv(lines)


def curves_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, grouped, curve, x, y, count: points of the curves over all out-of-fold rows.

    The curve ``precision_recall`` has recall as x, precision as y; ``reliability`` and
    ``reliability_calibrated`` have the mean probability as x, the share of right rows as y. The count is the
    number of rows up to, or in, the point.
    """
    lines: list[Sequence[Any]] = [("target", "family", "grouped", "curve", "x", "y", "count")]
    for comparison in comparisons:
        labels = comparison.data.labels
        for grouped, items in ((True, comparison.grouped), (False, comparison.ungrouped)):
            for family in sorted(items):
                head = (comparison.data.target, family, str(grouped).lower())
                item = items[family]
                precision, recall, threshold = precision_recall(item.probability, labels)
                ascending = np.sort(item.probability)
                for i in np.unique(np.geomspace(1, len(precision), _CURVE_POINTS).astype(np.int64) - 1):
                    count = len(labels) - int(np.searchsorted(ascending, threshold[i]))
                    point = (f"{recall[i]:.6g}", f"{precision[i]:.6g}", count)
                    lines.append((*head, "precision_recall", *point))
                curves = {"reliability": item.probability, "reliability_calibrated": item.calibrated}
                for name, probability in curves.items():
                    curve = reliability(probability, labels)
                    for x, y, n in zip(curve.predicted, curve.observed, curve.count, strict=True):
                        lines.append((*head, name, f"{x:.6g}", f"{y:.6g}", int(n)))
    return _csv(lines)


def importances_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, column, importance; a family without importances has no row."""
    lines: list[Sequence[Any]] = [("target", "family", "column", "importance")]
    for comparison in comparisons:
        for family in sorted(comparison.refits):
            importances = comparison.refits[family].importances
            if importances is None:
                continue
            for column, value in zip(comparison.data.columns, importances, strict=True):
                lines.append((comparison.data.target, family, column, f"{value:.6g}"))
    return _csv(lines)


def seconds_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, fold, seconds_per_10000_rows: times, never among the results of the study."""
    lines: list[Sequence[Any]] = [("target", "family", "fold", "seconds_per_10000_rows")]
    for comparison in comparisons:
        for family in sorted(comparison.grouped):
            for fold, seconds in enumerate(comparison.grouped[family].seconds_per_10000_rows):
                lines.append((comparison.data.target, family, fold, f"{seconds:.6f}"))
    return _csv(lines)


def card_metrics(comparison: Comparison, family: str) -> dict[str, dict[str, float]]:
    """Return metric -> mean, deviation, calibrated, ungrouped, for manifest and model card."""
    grouped = comparison.grouped[family]
    columns = {
        "mean": grouped.metrics,
        "deviation": grouped.deviations(),
        "calibrated": grouped.calibrated_metrics,
        "ungrouped": comparison.ungrouped[family].metrics,
    }
    return {
        name: {key: float(table[name]) for key, table in columns.items() if np.isfinite(table[name])}
        for name in METRICS
    }


def _csv(lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()
