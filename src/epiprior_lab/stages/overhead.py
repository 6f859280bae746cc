"""Stage `overhead`: a leaf that measures time; no other stage reads what it writes."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import track

from epiprior.estimators.handover import load_hand_overs
from epiprior_lab.evaluation.estimates import study_pairs
from epiprior_lab.evaluation.overhead import estimator_table, measure_pair, overhead_table
from epiprior_lab.params import load_study
from epiprior_lab.report.cascade_tables import cascade_seconds
from epiprior_lab.report.study import COLUMNS, read_table
from epiprior_lab.report.tables import write_table
from epiprior_lab.report.timing_figures import estimator_figure, overhead_figure

OUT = Path("reports/timings")


def main() -> None:
    """Write ``reports/timings/{pairs,overhead,estimators,cascade}.csv`` and ``{overhead,estimators}.png``."""
    params = load_study()
    families, seeds = params.scenes.families, params.timing.seeds
    inputs = params.evaluate.inputs_by_estimator
    hand_overs = load_hand_overs(Path("models/hand_over.json"))
    pairs = [
        (family, pair) for family in families for pair in study_pairs("test", family)[: params.timing.pairs_per_group]
    ]
    rows = []
    measure_pair(pairs[0][1], inputs, hand_overs, seeds[:1])  # compiles kernels, loads models
    for family, pair in track(pairs, description="overhead", console=Console(stderr=True)):
        rows += [{"family": family, **row} for row in measure_pair(pair, inputs, hand_overs, seeds)]
    timings = pd.DataFrame(rows)
    tables = [read_table(Path("data/evaluation") / family / "results.csv", COLUMNS["results"]) for family in families]
    overhead = overhead_table(timings, pd.concat(tables), params.report.success_px)
    estimators = estimator_table(timings, params.report.success_px)
    write_table(timings, OUT / "pairs.csv")
    write_table(overhead, OUT / "overhead.csv")
    write_table(estimators, OUT / "estimators.csv")
    cascade = read_table(Path("reports/cascade.csv"), "split family estimator preprocessed")
    write_table(cascade_seconds(overhead, cascade), OUT / "cascade.csv")
    overhead_figure(overhead, OUT / "overhead.png")
    estimator_figure(estimators, OUT / "estimators.png")


if __name__ == "__main__":
    main()
