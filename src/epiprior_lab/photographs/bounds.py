"""What was wanted on photographs, and what the numbers say of each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import FloatArray
from epiprior_lab.matching import PRESETS
from epiprior_lab.photographs.params import RealBoundParams
from epiprior_lab.photographs.results import ALL, OURS, Photographs, error_runs
from epiprior_lab.seeds import child_seed
from epiprior_lab.statistics import paired_bootstrap

PRECISION, HARD, CHAMPION, EASY = "precision", "hard", "champion", "easy"
_ROUNDING = 1e-9  # 99 of 100 is a loss of one hundredth
_ORDER = "kind group threshold_px estimator against wanted found low high possible kept of met"


def bounds_table(
    photographs: Photographs,
    successes: pd.DataFrame,
    rankings: pd.DataFrame,
    bounds: RealBoundParams,
    *,
    success_px: float,
    draws: int,
    seed: int,
) -> pd.DataFrame:
    """Return every bound and whether it is met.

    Parameters
    ----------
    photographs : Photographs
        Results.
    successes, rankings : DataFrame
        As from `tables.success_table` and `tables.ranking_table`.
    bounds : RealBoundParams
        What was wanted.
    success_px : float
        Threshold of the bounds on all estimators, pixels.
    draws, seed : int
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``kind``: `PRECISION` (difference of the top 100 over Lowe's order, all labelled pairs), `HARD` and `EASY` (the
        paper's contribution of the default preset, the lowest of all estimators), `CHAMPION` (contribution of the
        champion on our matches over the best peer combination: any other input, any estimator, the champion itself
        included). ``estimator, against``: whom the numbers are about; ``wanted, found, low, high`` (95 % interval over
        scenes); ``possible``, what would be found if every pair succeeded; ``kept`` of how many estimators ``of`` keep
        to the bound; ``met``, by the value, not by the interval. Without any such pair nothing is found, and not met.
    """
    rows = [
        _precision(rankings, bounds),
        _all_estimators(successes, "hard", HARD, bounds.hard_gain, success_px),
        *_champion(photographs, bounds, draws, seed),
        _all_estimators(successes, "easy", EASY, -bounds.easy_loss, success_px),
    ]
    numbers = dict.fromkeys(("threshold_px", "found", "low", "high", "possible", "kept", "of"), np.nan)
    table = pd.DataFrame([{**numbers, "estimator": "", "against": "", "met": False, **row} for row in rows])
    return table[_ORDER.split()]


def _precision(rankings: pd.DataFrame, bounds: RealBoundParams) -> dict[str, Any]:
    row: dict[str, Any] = {"kind": PRECISION, "group": ALL, "against": "Lowe's order", "wanted": bounds.precision_gain}
    at = rankings[(rankings["group"] == ALL) & (rankings["ranking"] == OURS)]
    if at.empty:
        return row
    found = at.iloc[0]
    value = float(found["precision_gain"])
    row |= {"found": value, "low": found["precision_gain_low"], "high": found["precision_gain_high"]}
    row["possible"] = 1 - (float(found["precision_100"]) - value)
    return row | {"met": value >= bounds.precision_gain - _ROUNDING}


def _all_estimators(
    successes: pd.DataFrame, group: str, kind: str, wanted: float, threshold_px: float
) -> dict[str, Any]:
    row: dict[str, Any] = {"kind": kind, "group": group, "threshold_px": threshold_px, "wanted": wanted}
    row["against"] = "without preprocessing"
    at = successes[(successes["group"] == group) & (successes["threshold_px"] == threshold_px)]
    ours = at[at["input"] == OURS]
    if ours.empty:
        return row
    worst = ours.sort_values("gain", kind="stable").iloc[0]
    kept = int((ours["gain"] >= wanted - _ROUNDING).sum())
    without = at[(at["estimator"] == worst["estimator"]) & at["gain"].isna()]["successes"].iloc[0]
    row |= {"estimator": worst["estimator"], "found": worst["gain"], "low": worst["gain_low"]}
    row |= {"high": worst["gain_high"], "possible": worst["pairs"] / without - 1 if without else np.inf}
    return row | {"kept": kept, "of": len(ours), "met": kept == len(ours)}


def _champion(photographs: Photographs, bounds: RealBoundParams, draws: int, seed: int) -> Iterator[dict[str, Any]]:
    errors = error_runs(photographs)
    member = photographs.groups.get("hard")
    for threshold, wanted in bounds.champion_gains.items():
        row: dict[str, Any] = {"kind": CHAMPION, "group": "hard", "threshold_px": threshold, "wanted": wanted}
        row["estimator"] = bounds.champion
        if member is None:
            yield row
            continue
        scenes = [scene for scene, inside in zip(photographs.scenes, member, strict=True) if inside]
        rates: dict[tuple[str, str], FloatArray] = {
            (estimator, name): (errors.of(estimator, name)[member] < threshold).mean(axis=1)
            for estimator in photographs.estimators
            for name in photographs.inputs(estimator)
            if name not in PRESETS
        }
        best = max(rates, key=lambda key: rates[key].sum())
        own = (errors.of(bounds.champion, OURS)[member] < threshold).mean(axis=1)
        child = child_seed(seed, CHAMPION, str(threshold))
        found = paired_bootstrap(rates[best], own, draws=draws, seed=child, groups=scenes).contribution
        share = float(rates[best].mean())
        row |= {"against": f"{best[0]} on {best[1]}", "found": found.value, "low": found.low, "high": found.high}
        yield row | {"possible": 1 / share - 1 if share else np.inf, "met": found.value >= wanted - _ROUNDING}
