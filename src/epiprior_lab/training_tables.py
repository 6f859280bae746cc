"""Tables of the training: measures, curves, importances and times of all families, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from epiprior_lab.calibration import cross_calibrate, reliability
from epiprior_lab.classifiers import Comparison
from epiprior_lab.metrics import METRICS, precision_recall

_CURVE_POINTS = 200


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
                if grouped:
                    tables["calibrated"] = comparison.calibrated_metrics(family)
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
                for i in np.unique(np.geomspace(1, len(precision), _CURVE_POINTS).astype(np.int64) - 1):
                    count = int(np.count_nonzero(item.probability >= threshold[i]))
                    point = (f"{recall[i]:.6g}", f"{precision[i]:.6g}", count)
                    lines.append((*head, "precision_recall", *point))
                curves = {"reliability": item.probability}
                if grouped:
                    curves["reliability_calibrated"] = cross_calibrate(item.probability, labels, item.fold)
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
            for column, value in zip(
                comparison.data.columns, () if importances is None else importances, strict=False
            ):
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
    """Return what manifest and model card say of a family: metric -> mean, deviation, calibrated, ungrouped."""
    grouped = comparison.grouped[family]
    columns = {
        "mean": grouped.metrics,
        "deviation": grouped.deviations(),
        "calibrated": comparison.calibrated_metrics(family),
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
