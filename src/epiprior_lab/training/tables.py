"""Results of training: measures, curves and importances as tables, and the two classifiers to export."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.metrics import precision_recall_curve

from epiprior_lab.measures import calibration_bins
from epiprior_lab.training.comparison import Comparison
from epiprior_lab.training.cross_validation import CrossValidation
from epiprior_lab.training.metrics import METRICS

_CURVE_POINTS = 200


def write_training(folder: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the results of training; the same results give the same bytes.

    Parameters
    ----------
    folder : Path
        Made if absent. It gets ``metrics.csv``, ``curves.csv``, ``importances.csv``, both exported classifiers as
        ``<target>.onnx``, ``parity.npz`` with rows and the classifiers' own probabilities of them, and
        ``summary.json`` with all that a manifest says of them.
    comparisons : sequence of Comparison
        For ``two_keypoint`` and ``match``, of one preset.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in (("metrics", metrics_csv), ("curves", curves_csv), ("importances", importances_csv)):
        (folder / f"{name}.csv").write_text(table(comparisons), encoding="utf-8")
    data = [comparison.data for comparison in comparisons]
    training_data: dict[str, Any] = {
        "sha256": hashlib.sha256("".join(rows.digest() for rows in data).encode()).hexdigest(),
        "scenes": len(np.unique(data[0].scene)),
        "rankings": len(data[0].pairs),
    }
    summary: dict[str, Any] = {"training_data": training_data}
    parity: dict[str, Any] = {}
    for comparison in comparisons:
        rows, refit = comparison.data, comparison.refit
        target = rows.target
        training_data |= {f"{target}_rows": len(rows.rows), f"{target}_right": int(rows.labels.sum())}
        (folder / f"{target}.onnx").write_bytes(refit.onnx)
        parity |= {f"{target}_rows": refit.parity_rows, f"{target}_probability": refit.parity_probability}
        summary[target] = {
            "family": comparison.exported,
            "columns": list(rows.columns),
            "a": comparison.platt.a,
            "b": comparison.platt.b,
            "metrics": card_metrics(comparison),
        }
    np.savez(folder / "parity.npz", **parity)
    text = json.dumps(summary, indent=2, sort_keys=True, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def _validations(comparison: Comparison) -> Iterator[tuple[str, str, CrossValidation]]:
    """Yield family, whether it is grouped as text, and cross-validation."""
    for family in sorted(comparison.grouped):
        yield family, "true", comparison.grouped[family]
    yield comparison.exported, "false", comparison.ungrouped


def metrics_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, grouped, fold, metric, value.

    The fold is a number, ``all``, ``deviation`` or ``calibrated``. Measures that are not defined have no row.
    """
    lines: list[Sequence[Any]] = [("target", "family", "grouped", "fold", "metric", "value")]
    for comparison in comparisons:
        for family, grouped, item in _validations(comparison):
            tables = {str(number): metrics for number, metrics in enumerate(item.fold_metrics)}
            tables |= {"all": item.metrics, "deviation": item.deviations(), "calibrated": item.calibrated_metrics}
            lines += [
                (comparison.data.target, family, grouped, fold, name, repr(float(table[name])))
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
        for family, grouped, item in _validations(comparison):
            head = (comparison.data.target, family, grouped)
            # Ascending thresholds; the last point, precision 1 at recall 0, is no threshold's.
            precision, recall, threshold = precision_recall_curve(labels, item.probability)
            counts = len(labels) - np.searchsorted(np.sort(item.probability), threshold)
            last = len(threshold) - 1
            for i in last - np.unique(np.geomspace(1, last + 1, _CURVE_POINTS).astype(np.int64) - 1):
                lines.append((*head, "precision_recall", f"{recall[i]:.6g}", f"{precision[i]:.6g}", int(counts[i])))
            for name, probability in (("reliability", item.probability), ("reliability_calibrated", item.calibrated)):
                if probability is not None:
                    for x, y, count in calibration_bins(probability, labels).curve:
                        lines.append((*head, name, f"{x:.6g}", f"{y:.6g}", int(count)))
    return _csv(lines)


def importances_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, column, importance of the exported classifiers; no rows if it has no importances."""
    lines: list[Sequence[Any]] = [("target", "family", "column", "importance")]
    for comparison in comparisons:
        if comparison.refit.importances is not None:
            for column, value in zip(comparison.data.columns, comparison.refit.importances, strict=True):
                lines.append((comparison.data.target, comparison.exported, column, f"{value:.6g}"))
    return _csv(lines)


def seconds_csv(comparisons: Iterable[Comparison]) -> str:
    """Return target, family, fold, seconds_per_10000_rows: times, never among the results of the study."""
    lines: list[Sequence[Any]] = [("target", "family", "fold", "seconds_per_10000_rows")]
    for comparison in comparisons:
        for family, item in sorted(comparison.grouped.items()):
            for fold, seconds in enumerate(item.seconds_per_10000_rows):
                lines.append((comparison.data.target, family, fold, f"{seconds:.6f}"))
    return _csv(lines)


def card_metrics(comparison: Comparison) -> dict[str, dict[str, float]]:
    """Return metric -> mean, deviation, calibrated, ungrouped of the exported family, for manifest and model card."""
    grouped = comparison.grouped[comparison.exported]
    columns = {
        "mean": grouped.metrics,
        "deviation": grouped.deviations(),
        "calibrated": grouped.calibrated_metrics,
        "ungrouped": comparison.ungrouped.metrics,
    }
    return {
        name: {key: float(table[name]) for key, table in columns.items() if np.isfinite(table[name])}
        for name in METRICS
    }


def _csv(lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()
