"""Stage `analysis`: what each part of the method contributes, what limits the results, and the paper's Table 1."""

from __future__ import annotations

from pathlib import Path

from epiprior.estimators.handover import load_hand_overs
from epiprior_lab.analysis.bench import AnalysisSettings
from epiprior_lab.analysis.steps import analyse_pairs
from epiprior_lab.compute.tasks import default_workers, single_threaded
from epiprior_lab.evaluation.estimates import study_pairs
from epiprior_lab.features.matching import PRESETS, model_files
from epiprior_lab.labels.ground_truth import LabelSettings
from epiprior_lab.params import load_study
from epiprior_lab.report.analysis_page import write_analysis
from epiprior_lab.report.analysis_tables import Analysis
from epiprior_lab.report.table1 import FamilyResults

DATA = Path("data/analysis")
OUT = Path("reports/analysis")


def main() -> None:
    """Write ``data/analysis/*.csv`` and everything in ``reports/analysis``."""
    params = load_study()
    report, own = params.report, params.analysis
    settings = AnalysisSettings(
        estimator=own.estimators[0],
        others=own.estimators[1:],
        beyond=report.champion,
        seeds=params.evaluate.seeds,
        two_keypoint_counts=own.two_keypoint_counts,
        refined_hypotheses=own.refined_hypotheses,
        success_px=report.success_px,
    )
    hand_overs = load_hand_overs(Path("models/hand_over.json"))
    analysis = analyse_pairs(
        {
            family: study_pairs("test", family)[: own.pairs_per_group]
            for family in (*report.hard_groups, *report.easy_groups)
        },
        complete=report.hard_groups,
        settings=settings,
        hand_overs=hand_overs,
        labels=LabelSettings.of(params.truth),
        files=model_files(Path("models"), PRESETS),
        workers=default_workers(),
        store=Path("data/.tasks/analysis"),
    )
    analysis.write(DATA)
    families = params.scenes.families
    with single_threaded():
        write_analysis(
            Analysis.read(DATA),
            {family: FamilyResults.read(Path("data/evaluation") / family) for family in families},
            {family: study_pairs("test", family) for family in families},
            OUT,
            thresholds_px=(report.success_px, report.strict_px),
            quantiles=own.table_quantiles,
            refined=own.refined_hypotheses,
            draws=report.bootstrap_draws,
            seed=report.seed,
        )


if __name__ == "__main__":
    main()
