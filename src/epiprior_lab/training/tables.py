"""Results of training: measures, curves and importances as tables, and the two classifiers to export."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.metrics import precision_recall_curve

from epiprior_lab.measures import calibration_bins
from epiprior_lab.training.comparison import Comparison
from epiprior_lab.training.cross_validation import METRICS, CrossValidation

_CURVE_POINTS = 200


def write_training(folder: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the results of training of one preset, ``two_keypoint`` and ``match``; the same give the same bytes.

    The folder, made if absent, gets ``metrics.csv``, ``curves.csv``, ``importances.csv``, the exported classifiers,
    ``<target>.onnx``, ``parity.npz`` with rows and their own probabilities, and ``summary.json`` for a manifest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in (("metrics", metrics_csv), ("curves", curves_csv), ("importances", importances_csv)):
        (folder / f"{name}.csv").write_text(table(comparisons), encoding="utf-8")
    data = [comparison.data for comparison in comparisons]
    sha256 = hashlib.sha256("".join(rows.digest() for rows in data).encode()).hexdigest()
    scenes, rankings = len(np.unique(data[0].scene)), len(data[0].pairs)
    training_data: dict[str, Any] = {"sha256": sha256, "scenes": scenes, "rankings": rankings}
    summary: dict[str, Any] = {"training_data": training_data}
    parity: dict[str, Any] = {}
    for comparison in comparisons:
        rows, refit, grouped = comparison.data, comparison.refit, comparison.grouped[comparison.exported]
        target = rows.target
        training_data |= {f"{target}_rows": len(rows.rows), f"{target}_right": int(rows.labels.sum())}
        (folder / f"{target}.onnx").write_bytes(refit.onnx)
        parity |= {f"{target}_rows": refit.parity_rows, f"{target}_probability": refit.parity_probability}
        measures = {"mean": grouped.metrics, "deviation": grouped.deviations()}
        measures |= {"calibrated": grouped.calibrated_metrics, "ungrouped": comparison.ungrouped.metrics}
        summary[target] = {"family": comparison.exported, "columns": list(rows.columns)}
        summary[target] |= dict(zip("ab", comparison.platt, strict=True))
        summary[target]["metrics"] = {
            name: {key: float(found[name]) for key, found in measures.items() if np.isfinite(found[name])}
            for name in METRICS
        }
    np.savez(folder / "parity.npz", **parity)
    text = json.dumps(summary, indent=2, sort_keys=True, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def _validations(comparisons: Iterable[Comparison]) -> Iterator[tuple[tuple[str, str, str], Any, CrossValidation]]:
    """Yield target, family and whether it is grouped, as text; labels; cross-validation."""
    for comparison in comparisons:
        target, labels = comparison.data.target, comparison.data.labels
        for family in sorted(comparison.grouped):
            yield (target, family, "true"), labels, comparison.grouped[family]
        yield (target, comparison.exported, "false"), labels, comparison.ungrouped


def metrics_csv(comparisons: Iterable[Comparison]) -> str:
    """Return the measures that are defined; the fold is a number, ``all``, ``deviation`` or ``calibrated``."""
    lines: list[Sequence[Any]] = []
    for head, _, item in _validations(comparisons):
        tables = {str(number): metrics for number, metrics in enumerate(item.fold_metrics)}
        tables |= {"all": item.metrics, "deviation": item.deviations(), "calibrated": item.calibrated_metrics}
        for fold, table in tables.items():
            defined = [name for name in METRICS if np.isfinite(table.get(name, np.nan))]
            lines += [(*head, fold, name, repr(float(table[name]))) for name in defined]
    return _csv("target family grouped fold metric value", lines)


def curves_csv(comparisons: Iterable[Comparison]) -> str:
    """Return points of the curves over all out-of-fold rows.

    The curve ``precision_recall`` has recall as x, precision as y; ``reliability`` and ``reliability_calibrated`` have
    the mean probability as x, the share of right rows as y. The count is the number of rows up to, or in, the point.
    """
    lines: list[Sequence[Any]] = []
    for head, labels, item in _validations(comparisons):
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
    return _csv("target family grouped curve x y count", lines)


def importances_csv(comparisons: Iterable[Comparison]) -> str:
    """Return the importances of the exported classifiers."""
    lines = [
        (comparison.data.target, comparison.exported, column, f"{value:.6g}")
        for comparison in comparisons
        for column, value in zip(comparison.data.columns, comparison.refit.importances, strict=True)
    ]
    return _csv("target family column importance", lines)


def _csv(header: str, lines: Sequence[Sequence[Any]]) -> str:
    return pd.DataFrame(lines, columns=header.split()).to_csv(index=False, lineterminator="\n")
