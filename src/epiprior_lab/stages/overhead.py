"""Stage `overhead`: a leaf that measures time; no other stage reads what it writes."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import track

from epiprior.handover import load_hand_overs
from epiprior_lab.evaluation import study_pairs
from epiprior_lab.overhead import measure_pair, overhead_figure, overhead_table
from epiprior_lab.params import load_params
from epiprior_lab.reports.study import COLUMNS, read_table
from epiprior_lab.reports.tables import write_table

OUT = Path("reports/timings")
PAIRS_PER_FAMILY = 3
SEEDS = (0, 1)


def main() -> None:
    """Write ``reports/timings/{pairs,overhead}.csv`` and ``overhead.png``."""
    params = load_params()
    estimators = params.evaluate.estimators
    hand_overs = load_hand_overs(Path("models/hand_over.json"))
    pairs = [
        (family, pair) for family in params.scenes.families for pair in study_pairs("test", family)[:PAIRS_PER_FAMILY]
    ]
    measure_pair(pairs[0][1], estimators, hand_overs, SEEDS[:1])  # compiles kernels, loads models
    rows = []
    for family, pair in track(pairs, description="overhead", console=Console(stderr=True)):
        rows += [{"family": family, **row} for row in measure_pair(pair, estimators, hand_overs, SEEDS)]
    timings = pd.DataFrame(rows)
    results = pd.concat(
        read_table(Path("data/evaluation") / family / "results.csv", COLUMNS["results"])
        for family in params.scenes.families
    )
    table = overhead_table(timings, results, params.report.success_px)
    write_table(timings, OUT / "pairs.csv")
    write_table(table, OUT / "overhead.csv")
    overhead_figure(table, OUT / "overhead.png")


if __name__ == "__main__":
    main()
