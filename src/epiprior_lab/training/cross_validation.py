"""Cross-validation of the families of classifiers, grouped by scene, and the measures that compare them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

from epiprior.errors import SettingsError
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.training.calibration import cross_calibrate
from epiprior_lab.training.families import Fitted, TrainingError, fit
from epiprior_lab.training.metrics import METRICS, ranking_metrics, row_metrics


@dataclass(frozen=True, kw_only=True)
class CrossValidation:
    """Out-of-fold probabilities of one family, and what they are worth.

    Parameters
    ----------
    family : str
        Name in `families.FAMILIES`.
    grouped : bool
        True: all rows of a scene are in one fold. False: rows are dealt out one by one, as in the paper.
    columns : tuple of str
        Names of the columns.
    probability : ndarray, shape (N,), float64
        Each by the classifier that was not trained on the row's fold.
    calibrated : ndarray, shape (N,), float64
        The same after Platt scaling fitted on the rows of the other folds.
    fold : ndarray, shape (N,), int64
        Fold of each row.
    metrics : mapping
        Each of `METRICS` over all rows: ranking metrics are means over pairs. NaN where undefined.
    calibrated_metrics : mapping
        The same of `calibrated`.
    fold_metrics : tuple of mapping
        The same over the rows of each fold. Ungrouped, a fold holds a part of every pair: no ranking metrics
        there.
    seconds_per_10000_rows : tuple of float
        Time to predict, per fold. Never part of what must be the same in every run.
    """

    family: str
    grouped: bool
    columns: tuple[str, ...]
    probability: FloatArray
    calibrated: FloatArray
    fold: IntArray
    metrics: Mapping[str, float]
    calibrated_metrics: Mapping[str, float]
    fold_metrics: tuple[Mapping[str, float], ...]
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
    """Deal scenes out to folds so that each fold has about the same share of right rows.

    Parameters
    ----------
    labels : ndarray, shape (N,), bool
        Which rows are right.
    scene : ndarray, shape (N,), str
        Scene of each row.
    folds : int
        Number of folds, at most the number of scenes.
    seed : int
        Of the shuffle.

    Returns
    -------
    ndarray, shape (N,), int64
        Fold of each row, in ``[0, folds)``; no scene is in two.

    Raises
    ------
    TrainingError
        If there are fewer scenes than folds.
    """
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


def cross_validate(
    family: str,
    X: Float32Array,
    y: BoolArray,
    scene: NDArray[np.str_],
    pair: NDArray[np.str_],
    *,
    columns: tuple[str, ...],
    folds: int = 10,
    seed: int,
    grouped: bool = True,
    max_rows: int | None = None,
    share: Mapping[str, float] | None = None,
) -> CrossValidation:
    """Fit a family without each fold in turn, and measure what it says of that fold.

    Parameters
    ----------
    family : str
        Name in `families.FAMILIES`.
    X : ndarray, shape (N, C), float32
        Rows.
    y : ndarray, shape (N,), bool
        Which are right.
    scene, pair : ndarray, shape (N,), str
        Scene and image pair of each row.
    columns : tuple of str
        Names of the C columns.
    folds : int
        Number of folds, >= 2.
    seed : int
        Of folds, samples and fits.
    grouped : bool
        Fold by scene (`folds_by_scene`), or by row (`folds_by_row`).
    max_rows : int, optional
        Train on so many rows at most. All rows are predicted and measured.
    share : mapping of str to float, optional
        For pairs of which `X` holds a random sample; see `ranking_metrics`.

    Returns
    -------
    CrossValidation
        The same bytes for the same input, `seconds_per_10000_rows` aside.

    Raises
    ------
    SettingsError
        If the family is unknown or there are fewer than two folds.
    TrainingError
        If shapes disagree, or folds cannot be made.
    """
    if folds < 2:
        raise SettingsError(f"folds = {folds}: expected 2 or more")
    if X.shape != (len(y), len(columns)) or len(scene) != len(y) or len(pair) != len(y):
        raise TrainingError(
            f"rows {X.shape}, {len(y)} labels, {len(scene)} scenes, {len(pair)} pairs and "
            f"{len(columns)} columns do not agree"
        )
    fold_seed = child_seed(seed, "folds")
    fold = folds_by_scene(y, scene, folds, fold_seed) if grouped else folds_by_row(y, folds, fold_seed)
    probability = np.empty(len(y))
    seconds = []
    for number in range(folds):
        held = fold == number
        fitted = fit_without(family, X, y, held, number, seed=seed, max_rows=max_rows)
        rows = X[held]
        start = time.perf_counter()
        probability[held] = fitted.probability(rows)
        seconds.append((time.perf_counter() - start) / max(1, len(rows)) * 10_000)
    fold_metrics = []
    for number in range(folds):
        held = fold == number
        measured = row_metrics(probability[held], y[held])
        if grouped:
            measured = ranking_metrics(probability[held], y[held], pair[held], share) | measured
        fold_metrics.append(measured)
    calibrated = cross_calibrate(probability, y, fold)
    return CrossValidation(
        family=family,
        grouped=grouped,
        columns=columns,
        probability=probability,
        calibrated=calibrated,
        fold=fold,
        metrics=ranking_metrics(probability, y, pair, share) | row_metrics(probability, y),
        calibrated_metrics=ranking_metrics(calibrated, y, pair, share) | row_metrics(calibrated, y),
        fold_metrics=tuple(fold_metrics),
        seconds_per_10000_rows=tuple(seconds),
    )


def fit_without(
    family: str,
    X: Float32Array,
    y: BoolArray,
    held: BoolArray,
    number: int,
    *,
    seed: int,
    max_rows: int | None = None,
) -> Fitted:
    """Fit a family without the rows `held` out in fold `number`: the very classifier of `cross_validate`."""
    return fit(family, X[~held], y[~held], seed=child_seed(seed, family, str(number)), max_rows=max_rows)


def fit_final(family: str, X: Float32Array, y: BoolArray, *, seed: int, max_rows: int | None = None) -> Fitted:
    """Fit a family on all rows: the classifier that is exported. Parameters as in `cross_validate`."""
    return fit(family, X, y, seed=child_seed(seed, family, "final"), max_rows=max_rows)


def _fold_of_rows(splits: object, rows: int) -> IntArray:
    """Turn scikit-learn's list of (train, test) indices into the fold of each row."""
    fold = np.full(rows, -1, np.int64)
    for number, (_, test) in enumerate(splits):  # type: ignore[arg-type, var-annotated]
        fold[test] = number
    return fold
