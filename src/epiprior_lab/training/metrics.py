"""Measures of a ranking and of probabilities; pairs count alike, however many rows they have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.training.calibration import expected_calibration_error

TOP = 100
RANKING_METRICS = ("precision_top_100", "average_precision")
ROW_METRICS = ("accuracy", "precision", "log_loss", "brier_score", "expected_calibration_error")
METRICS = RANKING_METRICS + ROW_METRICS
_CLIP = 1e-7


def ranking_metrics(
    probability: FloatArray,
    labels: BoolArray,
    pair: NDArray[np.str_],
    share: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return the means over pairs of the precision of the top 100 and of the average precision.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        What the rows are ordered by, within their pair.
    labels : ndarray, shape (N,), bool
        Which rows are right.
    pair : ndarray, shape (N,), str
        Pair of each row.
    share : mapping of str to float, optional
        For a pair of which only a random sample is here: its share of the pair's rows, in (0, 1]. The top 100
        of all rows are then estimated by the top 100 times the share of the sample.

    Returns
    -------
    dict
        ``precision_top_100``, the measure that decides, and ``average_precision``, which leaves out pairs
        without a right row. NaN for no pairs.
    """
    order = np.argsort(pair, kind="stable")
    bounds = np.flatnonzero(pair[order][1:] != pair[order][:-1]) + 1
    top, average = [], []
    for rows in np.split(order, bounds) if len(order) else []:
        here = 1.0 if share is None else share[str(pair[rows[0]])]
        top.append(precision_of_top(probability[rows], labels[rows], max(1, round(TOP * here))))
        average.append(average_precision(probability[rows], labels[rows]))
    known = [value for value in average if np.isfinite(value)]
    return {
        "precision_top_100": float(np.mean(top)) if top else float("nan"),
        "average_precision": float(np.mean(known)) if known else float("nan"),
    }


def precision_of_top(probability: FloatArray, labels: BoolArray, top: int = TOP) -> float:
    """Return the share of right rows among the `top` most probable; NaN for no rows.

    Fewer rows than `top` all count. Rows that tie for the last places count in part: the expected precision
    if ties are broken at random, so that a tree with few leaves gains nothing from the order of the rows.
    """
    top = min(top, len(labels))
    if not top:
        return float("nan")
    border = np.partition(probability, len(labels) - top)[len(labels) - top]
    above, tied = probability > border, probability == border
    share = (top - np.count_nonzero(above)) / np.count_nonzero(tied)
    return float((np.count_nonzero(labels[above]) + share * np.count_nonzero(labels[tied])) / top)


def average_precision(probability: FloatArray, labels: BoolArray) -> float:
    """Return the area under the precision-recall steps, tied rows taken together; NaN without a right row."""
    precision, recall, _ = precision_recall(probability, labels)
    if not labels.any():
        return float("nan")
    return float(np.sum(np.diff(recall, prepend=0.0) * precision))


def precision_recall(probability: FloatArray, labels: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return precision and recall down the ranking.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        What rows are ordered by.
    labels : ndarray, shape (N,), bool
        Which are right.

    Returns
    -------
    precision, recall, threshold : ndarray, shape (T,), float64
        One entry per distinct probability, descending; recall is NaN if there is no right row.
    """
    order = np.argsort(-probability, kind="stable")
    sorted_probability = probability[order]
    last = np.flatnonzero(np.append(sorted_probability[1:] != sorted_probability[:-1], True)[: len(order)])
    right = np.cumsum(labels[order])[last].astype(np.float64)
    total = float(labels.sum())
    recall = right / total if total else np.full(len(last), np.nan)
    return right / (last + 1), recall, sorted_probability[last]


def row_metrics(probability: FloatArray, labels: BoolArray) -> dict[str, float]:
    """Return accuracy and precision at 0.5 as in the paper, log loss, Brier score and calibration error.

    Parameters
    ----------
    probability : ndarray, shape (N,), float64
        In [0, 1]; for the log loss clipped to [1e-7, 1 - 1e-7].
    labels : ndarray, shape (N,), bool
        Which rows are right.

    Returns
    -------
    dict
        `ROW_METRICS`; precision is NaN if no probability is above 0.5, all are for no rows.
    """
    if not len(labels):
        return dict.fromkeys(ROW_METRICS, float("nan"))
    said = probability > 0.5
    p = np.clip(probability, _CLIP, 1 - _CLIP)
    return {
        "accuracy": float(np.mean(said == labels)),
        "precision": float(np.mean(labels[said])) if said.any() else float("nan"),
        "log_loss": float(-np.mean(np.where(labels, np.log(p), np.log1p(-p)))),
        "brier_score": float(np.mean((probability - labels) ** 2)),
        "expected_calibration_error": expected_calibration_error(probability, labels),
    }
