"""Stage `analysis`: what each part of the method contributes, what limits the results, and the paper's Table 1."""

from pathlib import Path

from epiprior.estimators.handover import load_hand_overs
from epiprior_lab.analysis.analyse import AnalysisSettings, analyse_pairs
from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.evaluation.inputs import PRESETS, model_files
from epiprior_lab.evaluation.protocol import MODELS, pairs_of
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.params import load_study
from epiprior_lab.report.analysis import write_analysis


def main() -> None:
    """Write ``data/analysis/*.csv`` and everything in ``reports/analysis``."""
    params = load_study()
    report, own, evaluate = params.report, params.analysis, params.evaluate
    pairs = {group: pairs_of(evaluate, group) for group in evaluate.groups}
    analysis = analyse_pairs(
        {group: pairs[group][: own.pairs_per_group] for group in (*report.hard_groups, *report.easy_groups)},
        complete=report.hard_groups,
        settings=AnalysisSettings(
            estimator=own.estimators[0],
            others=own.estimators[1:],
            beyond=report.champion,
            seeds=evaluate.seeds,
            two_keypoint_counts=own.two_keypoint_counts,
            refined_hypotheses=own.refined_hypotheses,
            success_px=report.success_px,
        ),
        hand_overs=load_hand_overs(MODELS / "hand_over.json"),
        labels=params.truth,
        files=model_files(MODELS, PRESETS),
        store=Path("data/.tasks/analysis"),
    )
    analysis.write(Path("data/analysis"))
    with single_threaded():
        evaluated = Tables.read([Path(evaluate.out) / group for group in evaluate.groups])
        write_analysis(analysis, evaluated, pairs, Path("reports/analysis"), params)


if __name__ == "__main__":
    main()
