"""Cross-validation of a family of classifiers, and its measures: of rankings within pairs, of probabilities of rows."""

import pickle
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn import config_context
from sklearn.metrics import average_precision_score, brier_score_loss, log_loss
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

from epiprior.types import BoolArray, FloatArray, IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.measures import calibration_bins
from epiprior_lab.training.calibration import cross_calibrate
from epiprior_lab.training.families import TrainingError, fit
from epiprior_lab.training.samples import TargetRows

TOP = 100
RANKING_METRICS = ("precision_top_100", "average_precision")
ROW_METRICS = ("accuracy", "precision", "log_loss", "brier_score", "expected_calibration_error")
METRICS = RANKING_METRICS + ROW_METRICS
_CLIP = 1e-7


@dataclass(frozen=True, kw_only=True)
class CrossValidation:
    """Out-of-fold probabilities of one family, and their measures.

    `fold` and `probability`, shape (N,): the fold of each row, and the probability by the classifier that was not
    trained on that fold; `calibrated` the same after Platt scaling fitted on the rows of the other folds, None for
    folds of rows. `metrics` and `calibrated_metrics` hold each of `METRICS` over all rows, NaN where undefined; the
    latter is empty without `calibrated`. `fold_metrics` are over the rows of each fold, without ranking metrics for
    folds of rows, which hold a part of every pair. `classifiers` are pickled, one per fold, if they were kept.
    `seconds_per_10000_rows`, the time to predict per fold, differs from run to run.
    """

    fold: IntArray
    probability: FloatArray
    calibrated: FloatArray | None
    metrics: Mapping[str, float]
    calibrated_metrics: Mapping[str, float]
    fold_metrics: tuple[Mapping[str, float], ...]
    classifiers: tuple[bytes, ...]
    seconds_per_10000_rows: tuple[float, ...]

    def deviations(self) -> dict[str, float]:
        """Return the standard deviation of each metric over folds (n - 1); NaN for fewer than two values."""
        result = {}
        for name in METRICS:
            values = np.array([fold.get(name, np.nan) for fold in self.fold_metrics])
            values = values[np.isfinite(values)]
            result[name] = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
        return result


def folds_by_scene(labels: BoolArray, scene: NDArray[np.str_], folds: int, seed: int) -> IntArray:
    """Deal scenes out to folds with about the same share of right rows; TrainingError if there are more folds."""
    names, code = np.unique(scene, return_inverse=True)
    if len(names) < folds:
        raise TrainingError(f"{len(names)} scenes for {folds} folds: every fold needs a scene")
    splitter = StratifiedGroupKFold(folds, shuffle=True, random_state=seed)
    fold = _fold_of_rows(splitter.split(code, labels, code), len(labels))
    if len(np.unique(fold)) < folds:
        # The greedy balance may leave a fold without a scene where scenes are few and uneven.
        fold = np.random.default_rng(seed).permutation(np.arange(len(names)) % folds)[code]
    return fold.astype(np.int64)


def folds_by_row(labels: BoolArray, folds: int, seed: int) -> IntArray:
    """Deal rows out to folds one by one, whatever their scene: the paper's procedure, which leaks."""
    rare = min(int(labels.sum()), int((~labels).sum()))
    if rare < folds:
        raise TrainingError(f"{rare} rows of the rarer class for {folds} folds: every fold needs one")
    splitter = StratifiedKFold(folds, shuffle=True, random_state=seed)
    return _fold_of_rows(splitter.split(labels, labels), len(labels))


def _fold_of_rows(splits: Iterable[tuple[IntArray, IntArray]], rows: int) -> IntArray:
    """Turn scikit-learn's (train, test) indices into the fold of each row."""
    fold = np.full(rows, -1, np.int64)
    for number, (_, test) in enumerate(splits):
        fold[test] = number
    return fold


def cross_validate(
    family: str,
    data: TargetRows,
    fold: IntArray,
    *,
    by_scene: bool,
    seed: int,
    max_rows: int | None = None,
    keep: bool = False,
) -> CrossValidation:
    """Fit a family without each fold in turn, and measure its probabilities of that fold.

    `fold`, shape (N,), is the fold of each row; `by_scene` says that all rows of a pair are in one. Each fit takes at
    most `max_rows`; all rows are predicted and measured. `keep` returns the folds' classifiers.
    """
    labels, slices = data.labels, data.slices
    probability = np.empty(len(labels))
    classifiers, seconds = [], []
    held = [fold == number for number in range(int(fold.max()) + 1)]
    for number, rows in enumerate(held):
        fit_seed = child_seed(seed, family, str(number))
        fitted = fit(family, data.rows[~rows], labels[~rows], seed=fit_seed, max_rows=max_rows)
        own = data.rows[rows]
        start = time.perf_counter()
        probability[rows] = fitted.probability(own)
        seconds.append((time.perf_counter() - start) / max(1, len(own)) * 10_000)
        if keep:
            classifiers.append(pickle.dumps(fitted))
    of_pairs = pair_metrics(probability, labels, slices, data.share)
    fold_metrics = [row_metrics(probability[rows], labels[rows]) for rows in held]
    calibrated, calibrated_metrics = None, {}
    if by_scene:
        fold_of_pair = np.array([fold[rows][0] if len(fold[rows]) else -1 for rows in slices])
        fold_metrics = [
            mean_over_pairs(of_pairs[fold_of_pair == number]) | metrics for number, metrics in enumerate(fold_metrics)
        ]
        calibrated = cross_calibrate(probability, labels, fold)
        calibrated_metrics = mean_over_pairs(pair_metrics(calibrated, labels, slices, data.share))
        calibrated_metrics |= row_metrics(calibrated, labels)
    return CrossValidation(
        fold=fold,
        probability=probability,
        calibrated=calibrated,
        metrics=mean_over_pairs(of_pairs) | row_metrics(probability, labels),
        calibrated_metrics=calibrated_metrics,
        fold_metrics=tuple(fold_metrics),
        classifiers=tuple(classifiers),
        seconds_per_10000_rows=tuple(seconds),
    )


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

    Rows that tie for the last places count in part: a tree with few leaves gains nothing from the order of the rows.
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
