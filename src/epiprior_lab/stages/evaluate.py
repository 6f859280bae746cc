"""Stage `evaluate`: estimators without and with the preprocessing step on the test pairs of one family."""

from __future__ import annotations

import argparse
from pathlib import Path

from epiprior.estimators.handover import load_hand_overs
from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.estimates import evaluate_pairs, study_pairs
from epiprior_lab.features.matching import model_files
from epiprior_lab.labels.ground_truth import LabelSettings
from epiprior_lab.params import load_params


def main() -> None:
    """Write ``data/evaluation/<family>/*.csv``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--family", required=True)
    family = parser.parse_args().family
    params = load_params()
    evaluation = evaluate_pairs(
        study_pairs("test", family),
        family=family,
        inputs=params.evaluate.inputs_by_estimator,
        seeds=params.evaluate.seeds,
        hand_overs=load_hand_overs(Path("models/hand_over.json")),
        labels=LabelSettings.of(params.truth),
        files=model_files(Path("models"), params.evaluate.all_inputs),
        workers=default_workers(),
        store=Path("data/.tasks/evaluate") / family,
    )
    evaluation.write(Path("data/evaluation") / family)


if __name__ == "__main__":
    main()
