"""Stage `overhead` of the second pipeline: a leaf that measures time; no other stage reads what it writes."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import track

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.evaluation.photographs.timing import bounds_of_time, measure_pair, overhead_table
from epiprior_lab.pairsets import Pair, read_pair_set
from epiprior_lab.params import PHOTOGRAPHS, load_params
from epiprior_lab.report.photographs.tables import write_real_table
from epiprior_lab.stages.real_evaluate import real_hand_overs

OUT = Path("reports/real/timings")


def main() -> None:
    """Write ``reports/real/timings/{pairs,overhead,bounds}.csv``."""
    params = load_params(PHOTOGRAPHS)
    timing, rule = params.timing, load_cascade_rule(Path("models/cascade.json"))
    inputs, hand_overs = params.evaluate.inputs_by_estimator, real_hand_overs(params)
    pairs = [
        (name, pair)
        for name in params.evaluate.groups
        if name not in (params.evaluate.apart or ())
        for pair in _spread(read_pair_set(Path("data/real") / name).pairs, timing.pairs_per_group)
    ]
    rows = []
    measure_pair(pairs[0][1], inputs, hand_overs, rule, timing.seeds[:1])  # compiles kernels, loads models
    for name, pair in track(pairs, description="overhead", console=Console(stderr=True)):
        rows += [{"set": name, **row} for row in measure_pair(pair, inputs, hand_overs, rule, timing.seeds)]
    timings = pd.DataFrame(rows)
    overhead = overhead_table(timings)
    write_real_table(timings, OUT / "pairs.csv")
    write_real_table(overhead, OUT / "overhead.csv")
    write_real_table(bounds_of_time(overhead), OUT / "bounds.csv")


def _spread(items: tuple[Pair, ...], count: int) -> list[Pair]:
    """Return so many of the items, evenly taken."""
    step = max(1, len(items) // count)
    return list(items[::step][:count])


if __name__ == "__main__":
    main()
