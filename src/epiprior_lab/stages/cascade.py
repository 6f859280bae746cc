"""Stage `cascade`: when an estimate without preprocessing is kept, chosen on validation scenes, tried on test pairs."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from epiprior.estimators.handover import load_hand_overs
from epiprior.verification.cascade import save_cascade_rule
from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.estimates import study_pairs
from epiprior_lab.features.matching import WITHOUT, model_files
from epiprior_lab.params import StudyParams, load_study
from epiprior_lab.report.cascade_figure import cascade_figure
from epiprior_lab.report.cascade_tables import cascade_markdown, cascade_table
from epiprior_lab.report.study import COLUMNS, read_table
from epiprior_lab.report.tables import write_table
from epiprior_lab.selection.cascade_rule import PREPROCESSED, learn_rule, paired_runs, validation_rows

OUT = Path("reports")


def validation_runs(params: StudyParams) -> pd.DataFrame:
    """Return the runs on validation scenes; matches are in the store of the stage `hand_over`."""
    hand_overs = load_hand_overs(Path("models/hand_over.json"))
    inputs = {
        estimator: tuple(name for name in names if name in (*WITHOUT, PREPROCESSED))
        for estimator, names in params.evaluate.inputs_by_estimator.items()
    }
    pairs = {family: study_pairs("validation", family) for family in params.scenes.families}
    family_of = {pair.pair_id: family for family, members in pairs.items() for pair in members}
    rows = validation_rows(
        [pair for members in pairs.values() for pair in members],
        inputs=inputs,
        matched=params.evaluate.all_inputs,
        seeds=params.cascade.seeds,
        hand_overs=hand_overs,
        files=model_files(Path("models"), params.evaluate.all_inputs),
        workers=default_workers(),
        store=Path("data/.tasks/validation"),
    )
    return paired_runs(pd.DataFrame([{"family": family_of[row["pair_id"]], **row} for row in rows]))


def evaluated_runs(params: StudyParams) -> pd.DataFrame:
    """Return the runs of the evaluation on test pairs."""
    tables = (
        read_table(Path("data/evaluation") / family / "results.csv", f"{COLUMNS['results']} spread plausibility")
        for family in params.scenes.families
    )
    return paired_runs(pd.concat(tables, ignore_index=True))


def main() -> None:
    """Write ``models/cascade.json`` and ``reports/cascade.{csv,md,png}``."""
    params = load_study()
    thresholds = (params.report.success_px, params.report.strict_px)
    validation = validation_runs(params)
    learnt = learn_rule(validation, params.cascade, success_px=thresholds[0], strict_px=thresholds[1])
    save_cascade_rule(Path("models/cascade.json"), learnt.rule)
    runs = {"validation": validation, "test": evaluated_runs(params)}
    table = cascade_table(
        runs, learnt.rule, thresholds_px=thresholds, draws=params.report.bootstrap_draws, seed=params.report.seed
    )
    write_table(table, OUT / "cascade.csv")
    text = cascade_markdown(table, learnt, params.cascade, thresholds)
    (OUT / "cascade.md").write_text(text, encoding="utf-8", newline="\n")
    cascade_figure(runs, learnt.rule, params.cascade, params.report.success_px, OUT / "cascade.png")


if __name__ == "__main__":
    main()
