"""Cross-validation of a family of classifiers, grouped by scene, and the measures that families are compared by."""

import pickle
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

from epiprior.types import BoolArray, FloatArray, IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.training.calibration import cross_calibrate
from epiprior_lab.training.families import TrainingError, fit
from epiprior_lab.training.metrics import METRICS, mean_over_pairs, pair_metrics, row_metrics
from epiprior_lab.training.samples import TargetRows


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
