"""Successes of all estimators: the paper's Table 2 with intervals, and one estimator against every other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.statistics import Interval, paired_bootstrap, success_curve
from epiprior_lab.features.matching import WITHOUT
from epiprior_lab.report.study import ReportError, Study, errors_of, order_of

ALL = "all"
COLUMNS = ("without", "snn", "paper", "default")
COMPARISONS = (("without", "paper"), ("without", "default"), ("snn", "default"))
DUEL_INPUTS = ("default", "snn")
ROUNDING = 1e-9  # sums of shares are off by about 1e-15: what is nearer to zero than this is zero


def performance_table(study: Study, *, thresholds_px: Sequence[float], draws: int, seed: int) -> pd.DataFrame:
    """Return successes per family and estimator, without and with the preprocessing step.

    Parameters
    ----------
    study : Study
        Results.
    thresholds_px : sequence of float
        Thresholds of success, pixels.
    draws, seed : int
        Of the bootstrap, which draws whole scenes.

    Returns
    -------
    DataFrame
        One row per threshold, family (``all`` last) and estimator: ``pairs``; ``without_input``, the input that
        the estimator gets without the step; for each of `COLUMNS` the number of successful pairs in the mean
        over seeds and its deviation ``<input>_sd``; for each of `COMPARISONS` the contribution
        ``<with>_over_<without>`` with the ends of its 95 % interval, ``_low`` and ``_high``, as shares, and the
        difference in pairs ``<with>_minus_<without>``, likewise. NaN where an estimator did not get the input.
    """
    known = _Errors(study)
    rows = []
    for threshold in thresholds_px:
        for family in known.families:
            for estimator in known.estimators:
                inputs = known.inputs(estimator)
                first, _ = known.of(family, estimator, inputs["without"])
                row: dict[str, Any] = {"threshold_px": threshold, "family": family, "estimator": estimator}
                row |= {"pairs": len(first), "without_input": inputs["without"]}
                for column in COLUMNS:
                    mean = deviation = np.array([np.nan])
                    if column in inputs:
                        errors, _ = known.of(family, estimator, inputs[column])
                        mean, deviation = success_curve(errors, [threshold])
                    row |= {column: float(mean[0]), f"{column}_sd": float(deviation[0])}
                child = child_seed(seed, family, estimator, str(threshold))
                rows.append(row | _comparisons(known, family, estimator, threshold, draws, child))
    return pd.DataFrame(rows)


class _Errors:
    """Errors by family, estimator and input, each looked up once."""

    def __init__(self, study: Study) -> None:
        self.families = (*study.families, ALL)
        self.estimators = order_of(study.results["estimator"])
        self._parts = {str(name): part for name, part in study.results.groupby("estimator", sort=False)}
        self._known: dict[tuple[str, str, str], tuple[FloatArray, list[str]]] = {}

    def of(self, family: str, estimator: str, name: str) -> tuple[FloatArray, list[str]]:
        """Return errors of shape (pairs, seeds), infinite without F, and the scene of each pair."""
        key = (family, estimator, name)
        if key not in self._known:
            where = {} if family == ALL else {"family": family}
            errors = errors_of(self._parts[estimator], input=name, **where)
            self._known[key] = errors.to_numpy(), [str(s) for s in errors.index.get_level_values("scene")]
        return self._known[key]

    def rates(self, family: str, estimator: str, name: str, threshold_px: float) -> tuple[FloatArray, list[str]]:
        """Return the share of seeds below the threshold for each pair, and the scene of each pair."""
        errors, scenes = self.of(family, estimator, name)
        return (errors < threshold_px).mean(axis=1), scenes

    def inputs(self, estimator: str) -> dict[str, str]:
        """Return the input behind each column of one estimator."""
        known = order_of(self._parts[estimator]["input"])
        without = [name for name in known if name in WITHOUT]
        if len(without) != 1:
            raise ReportError(f"results of {estimator}: one input of {', '.join(WITHOUT)} is expected")
        return {"without": without[0], **{name: name for name in known if name not in WITHOUT}}


def _comparisons(
    known: _Errors, family: str, estimator: str, threshold: float, draws: int, seed: int
) -> dict[str, float]:
    inputs = known.inputs(estimator)
    cells: dict[str, float] = {}
    for without, with_step in COMPARISONS:
        contribution = difference = Interval(value=np.nan, low=np.nan, high=np.nan)
        pairs = 0
        if without in inputs and with_step in inputs:
            a, scenes = known.rates(family, estimator, inputs[without], threshold)
            b, _ = known.rates(family, estimator, inputs[with_step], threshold)
            got = paired_bootstrap(a, b, draws=draws, seed=seed, groups=scenes)
            contribution, difference, pairs = got.contribution, got.difference, len(a)
        cells |= interval_cells(f"{with_step}_over_{without}", contribution, 1.0)
        cells |= interval_cells(f"{with_step}_minus_{without}", difference, float(pairs))
    return cells


def interval_cells(name: str, interval: Interval, factor: float = 1.0) -> dict[str, float]:
    """Return the columns `name`, `name`_low and `name`_high of an interval, times `factor`; rounding noise is 0."""
    ends = {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
    return {column: 0.0 if abs(value) < ROUNDING else value * factor for column, value in ends.items()}


def duel_table(study: Study, champion: str, *, thresholds_px: Sequence[float], draws: int, seed: int) -> pd.DataFrame:
    """Return one estimator against every other on the same input, pair by pair.

    Parameters
    ----------
    study : Study
        Results.
    champion : str
        The estimator that is compared with all others.
    thresholds_px, draws, seed
        As for `performance_table`.

    Returns
    -------
    DataFrame
        One row per threshold, family (``all`` last), input of `DUEL_INPUTS` and other estimator: ``pairs``;
        successful pairs of the ``champion`` and of the ``other``; their ``difference`` with the ends of its
        95 % interval, ``_low`` and ``_high``; ``verdict``: ``better`` or ``worse`` where the interval excludes
        zero, else ``open``.

    Raises
    ------
    ReportError
        If the champion has no results.
    """
    known = _Errors(study)
    if champion not in known.estimators:
        raise ReportError(f"no results of {champion}, only of {', '.join(known.estimators)}")
    rows = []
    for threshold in thresholds_px:
        for family in known.families:
            for name in DUEL_INPUTS:
                own, scenes = known.rates(family, champion, name, threshold)
                for estimator in (e for e in known.estimators if e != champion):
                    other, _ = known.rates(family, estimator, name, threshold)
                    child = child_seed(seed, "duel", family, estimator, name, str(threshold))
                    got = paired_bootstrap(other, own, draws=draws, seed=child, groups=scenes)
                    n = len(own)
                    rows.append(
                        {
                            "threshold_px": threshold,
                            "family": family,
                            "input": name,
                            "estimator": estimator,
                            "pairs": n,
                            "champion": got.with_step.value * n,
                            "other": got.without.value * n,
                            **interval_cells("difference", got.difference, float(n)),
                            "verdict": verdict(got.difference),
                        }
                    )
    return pd.DataFrame(rows)


def verdict(difference: Interval) -> str:
    """Return ``better`` or ``worse`` where the interval excludes zero by more than `ROUNDING`, else ``open``."""
    if difference.low > ROUNDING:
        return "better"
    return "worse" if difference.high < -ROUNDING else "open"
