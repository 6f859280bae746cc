"""What the evaluation of all sets left behind, as the report reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.features.matching import WITHOUT
from epiprior_lab.report.study import ReportError, order_of

ALL = "all"
OURS = "default"
_NAMES = ("set", "pair_id", "scene")
COLUMNS = {
    "pairs": "set pair_id scene labels points split standard_matches right_share",
    "results": "set pair_id scene estimator input seed status support matches spread plausibility "
    "iterations error_px median_error_px distance rotation_deg translation_deg",
    "rankings": "set pair_id scene ranking matches right precision_10 precision_100 precision_500 average_precision",
    "ranking_curves": "set pair_id scene ranking rank right",
    "calibration": "set pair_id scene preset bin count right probability squared_error",
}


@dataclass(frozen=True, kw_only=True)
class Photographs:
    """Results of all sets; ``pair`` and ``scene`` are unique across sets.

    Parameters
    ----------
    pairs, results, rankings, ranking_curves, calibration : DataFrame
        As in `COLUMNS`, with columns ``pair`` and ``split``; in the order of the sets.
    sets : tuple of str
        In the order of the report.
    apart : tuple of str
        Sets that are part of no total and no split.
    """

    pairs: pd.DataFrame
    results: pd.DataFrame
    rankings: pd.DataFrame
    ranking_curves: pd.DataFrame
    calibration: pd.DataFrame
    sets: tuple[str, ...]
    apart: tuple[str, ...]

    @classmethod
    def read(cls, data: Path, *, sets: Sequence[str], apart: Sequence[str]) -> Photographs:
        """Read ``data/<set>/*.csv``.

        Raises
        ------
        ReportError
            If a file is missing or lacks a column.
        """
        tables = {}
        for name, columns in COLUMNS.items():
            parts = [_table(data / folder / f"{name}.csv", columns) for folder in sets]
            table = pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)
            within = table["set"].astype(str) + "/"
            tables[name] = table.assign(pair=within + table["pair_id"], scene=within + table["scene"])
        splits = dict(zip(tables["pairs"]["pair"], tables["pairs"]["split"], strict=True))
        for name in set(COLUMNS) - {"pairs"}:
            tables[name] = tables[name].assign(split=tables[name]["pair"].map(splits))
        return cls(**tables, sets=tuple(sets), apart=tuple(apart))

    @property
    def groups(self) -> dict[str, BoolArray]:
        """Which rows of `pairs` belong to each group: splits that are not empty, all, then every set."""
        own = self.pairs["set"].to_numpy(str)
        counted = ~np.isin(own, list(self.apart))
        split = self.pairs["split"].to_numpy(str)
        groups = {name: counted & (split == name) for name in SPLITS}
        groups = {name: member for name, member in groups.items() if member.any()} | {ALL: counted}
        return groups | {name: own == name for name in self.sets}

    @property
    def counted(self) -> frozenset[str]:
        """Pairs that are part of the total."""
        return frozenset(self.pairs.loc[~self.pairs["set"].isin(self.apart), "pair"])

    @property
    def scenes(self) -> list[str]:
        """Scene of each row of `pairs`."""
        return [str(scene) for scene in self.pairs["scene"]]

    @property
    def estimators(self) -> list[str]:
        """Estimators in the order of the results."""
        return order_of(self.results["estimator"])

    def inputs(self, estimator: str) -> list[str]:
        """Return the inputs of one estimator; the one without preprocessing first, ours last.

        Raises
        ------
        ReportError
            If there is no such estimator or no such input.
        """
        known = order_of(self.results.loc[self.results["estimator"] == estimator, "input"])
        if not set(known) & set(WITHOUT):
            raise ReportError(f"results of {estimator}: no input of {', '.join(WITHOUT)}")
        return sorted(known, key=lambda name: (name not in WITHOUT, name == OURS))


def _table(path: Path, columns: str) -> pd.DataFrame:
    """Read a table whose names stay text; one without rows, since nothing could be labelled, has no header either."""
    try:
        if not path.read_text(encoding="utf-8").strip():
            return pd.DataFrame(columns=columns.split())
        table = pd.read_csv(path, dtype=dict.fromkeys(_NAMES, str))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ReportError(f"{path}: cannot be read as a table: {error}") from error
    missing = [name for name in columns.split() if name not in table.columns]
    if missing:
        raise ReportError(f"{path}: no column {missing[0]!r}")
    return table


class Runs:
    """A measure of every run by estimator and input, as arrays in the order of the pairs."""

    def __init__(self, photographs: Photographs, measure: Callable[[pd.DataFrame], Any]) -> None:
        table = photographs.results
        values = np.asarray(measure(table), np.float64)
        table = table.assign(value=np.where(np.isnan(values), np.inf, values))
        self._pairs = list(photographs.pairs["pair"])
        self._parts = dict(iter(table.groupby(["estimator", "input"], sort=False)))
        self._known: dict[tuple[str, str], FloatArray] = {}

    def of(self, estimator: str, name: str) -> FloatArray:
        """Return one row per pair, one column per seed; infinite where there is no F or no value."""
        key = (estimator, name)
        if key not in self._known:
            wide = self._parts[key].pivot_table(index="pair", columns="seed", values="value", aggfunc="first")
            self._known[key] = wide.reindex(self._pairs).fillna(np.inf).to_numpy(np.float64)
        return self._known[key]


def error_runs(photographs: Photographs) -> Runs:
    """Return the paper's error of every run, pixels."""
    return Runs(photographs, lambda table: table["error_px"])


def pose_runs(photographs: Photographs) -> Runs:
    """Return the larger of both angles of every run, degrees."""
    return Runs(photographs, lambda table: table[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False))


def distance_runs(photographs: Photographs) -> Runs:
    """Return the normalised symmetric geometric distance of every run."""
    return Runs(photographs, lambda table: table["distance"])


def scene_mean(values: FloatArray, scenes: Sequence[str]) -> float:
    """Return the mean over scenes of the means over their pairs: pairs of one scene are alike."""
    return float(pd.Series(values).groupby(list(scenes), sort=True).mean().mean())
