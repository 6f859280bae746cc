"""Time of the whole pipeline, from image files to F: without preprocessing, with it, and as a cascade.

Wall times of one process on a few pairs of each set; nothing else reads them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior.rank import rank_matches
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation.estimates import EstimatorInputs, HandOvers
from epiprior_lab.evaluation.photographs.estimation import run_estimator
from epiprior_lab.features.matching import WITHOUT, PairMatches, match_pair
from epiprior_lab.pairsets import Pair
from epiprior_lab.report.photographs.results import ALL, OURS
from epiprior_lab.report.study import order_of

Row = dict[str, Any]
MEDIAN_OVERHEAD, CASCADE_OVERHEAD = 2.0, 1.3  # as in benchmarks/bounds.yaml
MODES = ("without", "with", "cascade")


def measure_pair(
    pair: Pair,
    inputs: EstimatorInputs,
    hand_overs: HandOvers,
    rule: CascadeRule,
    seeds: Sequence[int],
) -> list[Row]:
    """Time one pair.

    Parameters
    ----------
    pair : Pair
        Its images are read anew for each input, since that is what a user pays.
    inputs : mapping of str to sequence of str
        For each estimator the inputs that it gets; those of peers and `snn` are left out.
    hand_overs : mapping
        ``hand_overs[estimator][input]``.
    rule : CascadeRule
        Of the cascade.
    seeds : sequence of int
        One run each.

    Returns
    -------
    list of dict
        ``pair_id, scene, estimator, seed``; ``seconds_without, seconds_with, seconds_cascade``; ``preprocessed``,
        whether the cascade did. As in the library, a cascade finds features once, except where what runs without
        preprocessing has candidates of its own.
    """
    matched: dict[str, tuple[PairMatches, float]] = {}
    for name in dict.fromkeys(name for names in inputs.values() for name in names if name in WITHOUT):
        start = time.perf_counter()
        matched[name] = match_pair(pair, (name,)), time.perf_counter() - start
    start = time.perf_counter()
    ranked = rank_matches(pair.image1, pair.image2, preset=OURS)
    ranking = time.perf_counter() - start
    factors = next(iter(matched.values()))[0].pixel_factors
    ours = PairMatches(sets={OURS: ranked.sets}, pixel_factors=factors)
    rows = []
    for estimator, names in inputs.items():
        without = next(name for name in names if name in WITHOUT)
        sets, matching = matched[without]
        shared = ranked.seconds.get("features", 0.0) if without == "standard" else 0.0
        for seed in seeds:
            start = time.perf_counter()
            first = run_estimator(
                sets, pair, estimator=estimator, name=without, seed=seed, how=hand_overs[estimator][without]
            )
            before = matching + time.perf_counter() - start
            start = time.perf_counter()
            run_estimator(ours, pair, estimator=estimator, name=OURS, seed=seed, how=hand_overs[estimator][OURS])
            after = ranking + time.perf_counter() - start
            kept = rule.keeps(first)
            row: Row = {"pair_id": pair.pair_id, "scene": pair.scene, "estimator": estimator, "seed": seed}
            row |= {"seconds_without": before, "seconds_with": after}
            row |= {"seconds_cascade": before if kept else before + after - shared, "preprocessed": not kept}
            rows.append(row)
    return rows


def overhead_table(timings: pd.DataFrame) -> pd.DataFrame:
    """Return medians over runs by estimator, ``all`` last.

    Parameters
    ----------
    timings : DataFrame
        Rows of `measure_pair`.

    Returns
    -------
    DataFrame
        ``estimator, runs``, median ``seconds_<mode>`` for each of `MODES`, median ``overhead`` and
        ``cascade_overhead`` (ratios to the time without, run by run), and ``preprocessed``, a share of the runs.
    """
    rows = []
    for estimator in (*order_of(timings["estimator"]), ALL):
        part = timings if estimator == ALL else timings[timings["estimator"] == estimator]
        row: Row = {"estimator": estimator, "runs": len(part)}
        row |= {f"seconds_{mode}": float(part[f"seconds_{mode}"].median()) for mode in MODES}
        row["overhead"] = float((part["seconds_with"] / part["seconds_without"]).median())
        row["cascade_overhead"] = float((part["seconds_cascade"] / part["seconds_without"]).median())
        row["preprocessed"] = float(np.mean(part["preprocessed"]))
        rows.append(row)
    return pd.DataFrame(rows)


def bounds_of_time(overhead: pd.DataFrame) -> pd.DataFrame:
    """Return what was wanted of the time, what was found over all estimators, and whether it is met."""
    found = overhead[overhead["estimator"] == ALL].iloc[0]
    rows = [
        {"bound": "median time with preprocessing over without", "wanted": MEDIAN_OVERHEAD}
        | {"found": found["overhead"], "met": bool(found["overhead"] <= MEDIAN_OVERHEAD)},
        {"bound": "median time of the cascade over without", "wanted": CASCADE_OVERHEAD}
        | {"found": found["cascade_overhead"], "met": bool(found["cascade_overhead"] <= CASCADE_OVERHEAD)},
    ]
    return pd.DataFrame(rows)
