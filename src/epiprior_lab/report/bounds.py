"""The bounds that were set before the study was run, and what the numbers say of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.report.performance import DUEL_INPUTS, ROUNDING
from epiprior_lab.report.study import ReportError


@dataclass(frozen=True, kw_only=True)
class BoundParams:
    """What the study wants to reach, as in ``benchmarks/bounds.yaml``."""

    hard_families: tuple[str, ...] = ("facades-hard", "open")
    easy_families: tuple[str, ...] = ("facades-easy",)
    contribution: Mapping[str, float] = field(default_factory=lambda: {"usac": 0.6, "beem": 0.3, "blogs": 0.4})
    easy_loss: float = 0.01


Cells = dict[tuple[str, str], dict[Any, Any]]

CONTRIBUTION, EASY, DUEL = "contribution", "easy", "duel"


def bounds_table(
    performance: pd.DataFrame,
    duels: pd.DataFrame,
    bounds: BoundParams,
    *,
    success_px: float,
    thresholds_px: Sequence[float],
) -> pd.DataFrame:
    """Return every bound and whether it is met.

    Parameters
    ----------
    performance, duels : DataFrame
        As from `performance.performance_table` and `performance.duel_table`.
    bounds : BoundParams
        What was wanted.
    success_px : float
        Threshold of the contributions, pixels.
    thresholds_px : sequence of float
        Thresholds at which the champion must beat the others, pixels.

    Returns
    -------
    DataFrame
        ``kind``: `CONTRIBUTION` (of the default preset over the input without, as a share), `EASY` (the same,
        worst of all estimators) or `DUEL` (pairs that the champion is ahead of the rival whose interval
        reaches lowest); ``family, threshold_px, input``; ``estimator``, whom the numbers are about;
        ``wanted, found, low, high``; ``possible``, what would be found if the step, or the champion of a duel,
        solved every pair;
        ``beaten`` of ``others`` estimators; ``met``. A contribution is met by its value, a duel only by an
        interval that excludes zero for every rival.

    Raises
    ------
    ReportError
        If a table lacks an estimator or a family.
    """
    records = performance[performance["threshold_px"] == success_px].to_dict("records")
    at = {(row["family"], row["estimator"]): row for row in records}
    rows = [*_contributions(at, bounds), *_easy(at, bounds), *_duels(duels, bounds, thresholds_px)]
    empty = {"threshold_px": success_px, "input": "default", "possible": np.nan, "beaten": np.nan, "others": np.nan}
    order = "kind family threshold_px input estimator wanted found low high possible beaten others met"
    return pd.DataFrame([{**empty, **row} for row in rows])[order.split(" ")]


def _contributions(at: Cells, bounds: BoundParams) -> Iterator[dict[str, Any]]:
    for estimator, wanted in bounds.contribution.items():
        for family in bounds.hard_families:
            if (family, estimator) not in at:
                raise ReportError(f"the performance table has no row of {estimator} on {family}")
            cells = _contribution(at, family, estimator)
            yield {"kind": CONTRIBUTION, "wanted": wanted, **cells, "met": cells["found"] >= wanted - ROUNDING}


def _easy(at: Cells, bounds: BoundParams) -> Iterator[dict[str, Any]]:
    for family in bounds.easy_families:
        cells = [_contribution(at, *place) for place in at if place[0] == family]
        if not cells:
            raise ReportError(f"the performance table has no rows of {family}")
        worst = min(cells, key=lambda cell: cell["found"])
        # 99 of 100 is a loss of one hundredth.
        kept = sum(cell["found"] >= -bounds.easy_loss - ROUNDING for cell in cells)
        met = kept == len(cells)
        yield {"kind": EASY, "wanted": -bounds.easy_loss, **worst, "beaten": kept, "others": len(cells), "met": met}


def _contribution(at: Cells, family: str, estimator: str) -> dict[str, Any]:
    row = at[family, estimator]
    without, pairs = float(row["without"]), float(row["pairs"])
    return {
        "family": family,
        "estimator": estimator,
        "found": float(row["default_over_without"]),
        "low": float(row["default_over_without_low"]),
        "high": float(row["default_over_without_high"]),
        "possible": pairs / without - 1 if without else np.inf,
    }


def _duels(duels: pd.DataFrame, bounds: BoundParams, thresholds_px: Sequence[float]) -> Iterator[dict[str, Any]]:
    for family in bounds.hard_families:
        for name in DUEL_INPUTS:
            for threshold in thresholds_px:
                here = (duels["family"] == family) & (duels["input"] == name) & (duels["threshold_px"] == threshold)
                part = duels[here].sort_values(["difference_low", "difference"], kind="stable")
                if part.empty:
                    raise ReportError(f"the table of duels has no rows of {family}, {name}, {threshold:g} px")
                rival = part.iloc[0]
                beaten = int((part["verdict"] == "better").sum())
                yield {
                    "kind": DUEL,
                    "family": family,
                    "threshold_px": threshold,
                    "input": name,
                    "estimator": rival["estimator"],
                    "wanted": 0.0,
                    "found": rival["difference"],
                    "low": rival["difference_low"],
                    "high": rival["difference_high"],
                    "possible": rival["pairs"] - rival["other"],
                    "beaten": beaten,
                    "others": len(part),
                    "met": beaten == len(part),
                }
