"""The four tables of an evaluation as the report reads them: which pairs form a group, and every measure by pair."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.errors import EpipriorError
from epiprior.types import BoolArray, FloatArray, Status
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.compare import POSE, Rates, group_masks
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.evaluation.statistics import Comparison, Interval, paired_bootstrap
from epiprior_lab.report.text import ALL, BASELINES, DIFFICULTIES, OURS, order_of

ROUNDING = 1e-9  # sums of shares are off by about 1e-15: what is nearer to zero than this is zero


class ReportError(EpipriorError):
    """A table of results cannot be read, lacks a column or lacks the rows that are asked for."""


class Results:
    """The results of an evaluation, compared by ``group`` (families of scenes) or by ``difficulty``.

    Groups in `apart` are part of no total and no difficulty; `hard` are those of `by` that are hard; `draws` and `seed`
    are of the bootstrap, which draws whole scenes. `main` are the groups that tables show, `ALL` last; `masks` tells
    which pairs belong to each of these and, by difficulty, to every set.
    """

    def __init__(
        self, tables: Tables, *, by: str, hard: Sequence[str], apart: Sequence[str] = (), draws: int, seed: int
    ) -> None:
        self.tables, self.by, self.apart, self._draws, self._seed = tables, by, tuple(apart), draws, seed
        masks = group_masks(tables.pairs, apart=apart)
        self.sets = tuple(order_of(tables.pairs["group"]))
        first = self.sets if by == "group" else tuple(name for name in DIFFICULTIES if name in masks)
        self.main = (*first, ALL)
        self.masks: dict[str, BoolArray] = {name: masks[name] for name in dict.fromkeys((*self.main, *self.sets))}
        self.hard = tuple(name for name in hard if name in self.main)
        self.errors, self.poses, self.distances = (Rates(tables, m) for m in ("error_px", POSE, "distance"))
        runs = tables.runs
        accepted = runs.assign(error_px=runs["error_px"].where(runs["status"] == Status.OK))
        self.accepted = Rates(replace(tables, runs=accepted))
        self.scenes = np.array(self.errors.scenes, dtype=object)
        self.estimators = self.errors.estimators

    @property
    def hard_pairs(self) -> BoolArray:
        """Pairs of the hard groups."""
        none = np.zeros(len(self.scenes), np.bool_)
        return np.asarray(np.any([none, *(self.masks[name] for name in self.hard)], axis=0))

    @property
    def inputs_of_all(self) -> list[str]:
        """Every input of any estimator; baselines first, ours last."""
        return _ordered(dict.fromkeys(name for e in self.estimators for name in self.errors.inputs(e)))

    def inputs(self, estimator: str) -> list[str]:
        """Return the inputs of one estimator; the one without preprocessing, which must be there, first, ours last."""
        known = self.errors.inputs(estimator)
        if not set(known) & set(BASELINES):
            raise ReportError(f"results of {estimator}: no input of {', '.join(BASELINES)}")
        return _ordered(known)

    def rows_of(self, table: pd.DataFrame, member: BoolArray) -> pd.DataFrame:
        """Return the rows of a table, such as `Tables.rankings`, that are of certain pairs."""
        chosen = pd.MultiIndex.from_frame(self.tables.pairs.loc[member, ["group", "pair_id"]])
        return table[pd.MultiIndex.from_frame(table[["group", "pair_id"]]).isin(chosen)]

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
        """Return `interval_columns`; one scene gives a value and no interval, since whole scenes are drawn."""
        columns = interval_columns(name, interval, factor)
        if len(set(self.scenes[member])) < 2:
            columns |= {f"{name}_low": np.nan, f"{name}_high": np.nan}
        return columns


def interval_columns(name: str, interval: Interval, factor: float = 1.0) -> dict[str, float]:
    """Return the columns `name`, `name`_low and `name`_high of an interval, times `factor`; rounding noise is 0."""
    ends = {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
    return {column: 0.0 if abs(value) < ROUNDING else value * factor for column, value in ends.items()}


def _ordered(names: Any) -> list[str]:
    return sorted(names, key=lambda name: (name not in BASELINES, name == OURS))


def read_table(path: Path, columns: str) -> pd.DataFrame:
    """Read a CSV file that must have certain columns, separated by blanks; a ReportError names what is missing."""
    try:
        table = pd.read_csv(path, keep_default_na=True)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ReportError(f"{path}: cannot be read as a table: {error}") from error
    missing = [name for name in columns.split() if name not in table.columns]
    if missing:
        raise ReportError(f"{path}: no column {missing[0]!r}")
    return table
