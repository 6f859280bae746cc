"""The four tables of an evaluation as the report reads them: which pairs form a group, and every measure by pair."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior.errors import EpipriorError
from epiprior.types import BoolArray, FloatArray, Status
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.evaluation.statistics import Comparison, Interval, paired_bootstrap
from epiprior_lab.params import ReportParams
from epiprior_lab.report.text import ALL, BASELINES, DIFFICULTIES, OURS, order_of

PAIR = ["group", "pair_id"]  # what names a pair in every table
ROUNDING = 1e-9  # sums of shares are off by about 1e-15: what is nearer to zero than this is zero


class ReportError(EpipriorError):
    """A table of results lacks the rows that are asked for, or bounds cannot be read."""


def where(table: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """Return the rows of a table that have these values in columns of these names."""
    for column, value in values.items():
        table = table[table[column] == value]
    return table


class Rates(dict[tuple[str, str], FloatArray]):
    """A measure of every run by estimator and input, shape (pairs, seeds), in the order of ``tables.pairs``.

    `measure` has a value per row of ``tables.runs``; infinite without an F, without a run, or where the truth does not
    allow it.
    """

    def __init__(self, tables: Tables, measure: pd.Series[float]) -> None:
        super().__init__()
        table = tables.runs[[*PAIR, "estimator", "input", "seed"]].assign(value=measure.fillna(np.inf).to_numpy())
        index = pd.MultiIndex.from_frame(tables.pairs[PAIR])
        for (estimator, name), part in table.groupby(["estimator", "input"], sort=False):
            wide = part.set_index([*PAIR, "seed"])["value"].unstack("seed").reindex(index)
            self[str(estimator), str(name)] = wide.fillna(np.inf).to_numpy(np.float64)

    def of(self, estimator: str, name: str, threshold: float) -> FloatArray:
        """Return the share of seeds strictly below the threshold for each pair, shape (pairs,)."""
        return np.asarray((self[estimator, name] < threshold).mean(axis=1))


class Results:
    """The results of an evaluation by group, or by difficulty where the hard groups of the parameters are difficulties.

    Groups in `apart` are part of no total and no difficulty. `main` are the groups that tables show, `ALL` last, and
    `hard` the hard ones; `masks` tells which pairs belong to each of these and, by difficulty, to every set.
    """

    def __init__(self, tables: Tables, params: ReportParams, *, apart: Sequence[str] = ()) -> None:
        self.tables, self.apart, self._draws, self._seed = tables, tuple(apart), params.bootstrap_draws, params.seed
        runs, pairs = tables.runs, tables.pairs
        self.index = pd.MultiIndex.from_frame(pairs[PAIR])
        self.sets = tuple(order_of(pairs["group"]))
        counted = np.asarray(~pairs["group"].isin(apart))
        masks = {name: counted & (pairs["difficulty"] == name).to_numpy() for name in DIFFICULTIES}
        masks = {name: member for name, member in masks.items() if member.any()} | {ALL: counted}
        masks |= {name: (pairs["group"] == name).to_numpy() for name in self.sets}
        by_difficulty = set(params.hard_groups) <= set(DIFFICULTIES)
        first = tuple(name for name in DIFFICULTIES if name in masks) if by_difficulty else self.sets
        self.main = (*first, ALL)
        self.masks: dict[str, BoolArray] = {name: masks[name] for name in dict.fromkeys((*self.main, *self.sets))}
        self.hard = tuple(name for name in params.hard_groups if name in self.main)
        self.pose_deg = runs[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False)  # the larger of both angles
        self.errors, self.distances = Rates(tables, runs["error_px"]), Rates(tables, runs["distance"])
        self.poses = Rates(tables, self.pose_deg)
        self.accepted = Rates(tables, runs["error_px"].where(runs["status"] == Status.OK))
        self.scenes = (pairs["group"] + "/" + pairs["scene"]).to_numpy(object)  # unique across groups
        self.estimators = list(dict.fromkeys(estimator for estimator, _ in self.errors))

    @property
    def hard_pairs(self) -> BoolArray:
        """Pairs of the hard groups."""
        none = np.zeros(len(self.scenes), np.bool_)
        return np.asarray(np.any([none, *(self.masks[name] for name in self.hard)], axis=0))

    @property
    def inputs_of_all(self) -> list[str]:
        """Every input of any estimator; baselines first, ours last."""
        return ordered(dict.fromkeys(name for e in self.estimators for owner, name in self.errors if owner == e))

    def inputs(self, estimator: str) -> list[str]:
        """Return the inputs of one estimator; the one without preprocessing, which must be there, first, ours last."""
        known = [name for owner, name in self.errors if owner == estimator]
        if not set(known) & set(BASELINES):
            raise ReportError(f"results of {estimator}: no input of {', '.join(BASELINES)}")
        return ordered(known)

    def rows_of(self, table: pd.DataFrame, member: BoolArray) -> pd.DataFrame:
        """Return the rows of a table, such as `Tables.rankings`, that are of certain pairs."""
        return table[pd.MultiIndex.from_frame(table[PAIR]).isin(self.index[member])]

    def by_pair(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return a table of one row for some of the pairs with a row for each, in their order; NaN for others."""
        return table.set_index(PAIR).reindex(self.index)

    def groups(self, names: Sequence[str] = ()) -> Iterator[tuple[str, BoolArray]]:
        """Yield the groups of `names`, or all of them, that have pairs, each with its pairs."""
        for name in names or self.masks:
            if self.masks[name].any():
                yield name, self.masks[name]

    def compare(self, a: FloatArray, b: FloatArray, member: BoolArray, *key: str) -> Comparison:
        """Compare two measures of pairs among those of `member`; whole scenes are drawn, and `key` names the draw."""
        how: dict[str, Any] = {"draws": self._draws, "seed": child_seed(self._seed, *key)}
        return paired_bootstrap(a[member], b[member], groups=self.scenes[member].tolist(), **how)

    def compare_scenes(self, a: FloatArray, b: FloatArray, *key: str) -> Comparison:
        """Compare two measures with one value per scene, as from `per_scene`."""
        return paired_bootstrap(a, b, draws=self._draws, seed=child_seed(self._seed, *key))

    def per_scene(self, values: FloatArray, member: BoolArray) -> FloatArray:
        """Return means over the pairs of each scene, by scene: pairs of one scene are alike."""
        return np.asarray(pd.Series(values[member]).groupby(self.scenes[member], sort=True).mean(), np.float64)

    def interval(self, name: str, interval: Interval, member: BoolArray, factor: float = 1.0) -> dict[str, float]:
        """Return `interval_columns` of some pairs."""
        return interval_columns(name, interval, factor, scenes=len(set(self.scenes[member])))


def interval_columns(name: str, interval: Interval, factor: float = 1.0, *, scenes: int = 2) -> dict[str, float]:
    """Return the columns `name`, `name`_low and `name`_high of an interval, times `factor`; rounding noise is 0.

    One of the `scenes` gives a value and no interval, since whole scenes are drawn.
    """
    low, high = (interval.low, interval.high) if scenes > 1 else (np.nan, np.nan)
    ends = {name: interval.value, f"{name}_low": low, f"{name}_high": high}
    return {column: 0.0 if abs(value) < ROUNDING else value * factor for column, value in ends.items()}


def ordered(names: Iterable[str]) -> list[str]:
    """Return inputs, baselines first, ours last."""
    return sorted(names, key=lambda name: (name not in BASELINES, name == OURS))
