"""What the families of classifiers are compared by: rankings within pairs, and probabilities of rows."""

from collections.abc import Sequence

import numpy as np
from sklearn import config_context
from sklearn.metrics import average_precision_score, brier_score_loss, log_loss

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.measures import calibration_bins

TOP = 100
RANKING_METRICS = ("precision_top_100", "average_precision")
ROW_METRICS = ("accuracy", "precision", "log_loss", "brier_score", "expected_calibration_error")
METRICS = RANKING_METRICS + ROW_METRICS
_CLIP = 1e-7


def pair_metrics(probability: FloatArray, labels: BoolArray, pairs: Sequence[slice], share: FloatArray) -> FloatArray:
    """Return `RANKING_METRICS` of each pair, shape (P, 2).

    `share`, shape (P,), in (0, 1], says which share of the pair's rows is here, a random sample: the top 100 of all
    rows are estimated by the top 100 times that share. NaN without rows; average precision without a right row, too.
    """
    values = np.full((len(pairs), 2), np.nan)
    with config_context(assume_finite=True, skip_parameter_validation=True):
        for i, (rows, here) in enumerate(zip(pairs, share, strict=True)):
            p, right = probability[rows], labels[rows]
            values[i, 0] = precision_of_top(p, right, max(1, round(TOP * here)))
            if right.any():
                values[i, 1] = average_precision_score(right, p)
    return values


def mean_over_pairs(values: FloatArray) -> dict[str, float]:
    """Return the means of `pair_metrics` over the pairs that have them: pairs count alike; NaN if there are none."""
    known = [column[np.isfinite(column)] for column in values.T]
    return {
        name: float(column.mean()) if len(column) else float("nan")
        for name, column in zip(RANKING_METRICS, known, strict=True)
    }


def precision_of_top(probability: FloatArray, labels: BoolArray, top: int = TOP) -> float:
    """Return the share of right rows among the `top` most probable, or among all if fewer; NaN for no rows.

    Rows that tie for the last places count in part, as expected if ties are broken at random: a tree with few leaves
    gains nothing from the order of the rows.
    """
    top = min(top, len(labels))
    if not top:
        return float("nan")
    border = np.partition(probability, len(labels) - top)[len(labels) - top]
    above, tied = probability > border, probability == border
    share = (top - np.count_nonzero(above)) / np.count_nonzero(tied)
    return float((np.count_nonzero(labels[above]) + share * np.count_nonzero(labels[tied])) / top)


def row_metrics(probability: FloatArray, labels: BoolArray) -> dict[str, float]:
    """Return `ROW_METRICS`, NaN for no rows: accuracy, precision at 0.5 as in the paper; measures of probabilities."""
    if not len(labels):
        return dict.fromkeys(ROW_METRICS, float("nan"))
    said = probability > 0.5
    classes = [False, True]
    return {
        "accuracy": float(np.mean(said == labels)),
        "precision": float(np.mean(labels[said])) if said.any() else float("nan"),
        "log_loss": float(log_loss(labels, np.clip(probability, _CLIP, 1 - _CLIP), labels=classes)),
        "brier_score": float(brier_score_loss(labels, probability, labels=classes)),
        "expected_calibration_error": calibration_bins(probability, labels).expected_calibration_error,
    }
