"""Success rates per pair, and which pairs are compared."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.evaluation.records import DIFFICULTIES, Tables

ALL = "all"
POSE = "pose_deg"  # the larger of both angles


class Rates:
    """A measure of every run by estimator and input, as arrays in the order of ``tables.pairs``.

    `measure` is a column of `runs`, or `POSE`; a pair without a run is a failure. `scenes` are unique across groups.
    """

    def __init__(self, tables: Tables, measure: str = "error_px") -> None:
        self.pairs = tables.pairs
        self.scenes = [f"{g}/{s}" for g, s in zip(self.pairs["group"], self.pairs["scene"], strict=True)]
        runs = tables.runs
        values = (
            runs[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False) if measure == POSE else runs[measure]
        )
        table = runs[["group", "pair_id", "estimator", "input", "seed"]].assign(value=values.fillna(np.inf))
        self._parts = dict(iter(table.groupby(["estimator", "input"], sort=False)))
        self._index = pd.MultiIndex.from_frame(self.pairs[["group", "pair_id"]])
        self._known: dict[tuple[str, str], FloatArray] = {}

    @property
    def estimators(self) -> list[str]:
        """Estimators in the order of the runs."""
        return list(dict.fromkeys(str(estimator) for estimator, _ in self._parts))

    def inputs(self, estimator: str) -> list[str]:
        """Return the inputs of one estimator, in the order of the runs."""
        return [str(name) for owner, name in self._parts if owner == estimator]

    def values(self, estimator: str, name: str) -> FloatArray:
        """Return the measure, shape (pairs, seeds); infinite without an F or where the truth does not allow it."""
        key = (estimator, name)
        if key not in self._known:
            part = self._parts[key].set_index(["group", "pair_id", "seed"])["value"]
            wide = part.unstack("seed").reindex(self._index)
            self._known[key] = wide.fillna(np.inf).to_numpy(np.float64)
        return self._known[key]

    def of(self, estimator: str, name: str, threshold: float) -> FloatArray:
        """Return the share of seeds strictly below the threshold for each pair, shape (pairs,)."""
        return np.asarray((self.values(estimator, name) < threshold).mean(axis=1))


def group_masks(pairs: pd.DataFrame, *, apart: Sequence[str] = ()) -> dict[str, BoolArray]:
    """Return which pairs belong to each part: difficulties that occur, `ALL`, then every group.

    Groups in `apart` are part of no total and no difficulty.
    """
    own, difficulty = pairs["group"].to_numpy(str), pairs["difficulty"].to_numpy(str)
    counted = np.asarray(~np.isin(own, list(apart)))
    masks = {name: counted & (difficulty == name) for name in DIFFICULTIES}
    masks = {name: member for name, member in masks.items() if member.any()} | {ALL: counted}
    return masks | {str(name): own == name for name in pairs["group"].unique()}
