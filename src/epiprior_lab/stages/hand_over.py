"""Stage `hand_over`: how matches are handed to each estimator, chosen on validation scenes."""

from __future__ import annotations

from pathlib import Path

from epiprior.estimators.handover import save_hand_overs
from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.estimates import study_pairs, write_rows
from epiprior_lab.features.matching import model_files
from epiprior_lab.params import load_study
from epiprior_lab.selection.hand_over_search import chosen_hand_overs, search_hand_overs


def main() -> None:
    """Write ``models/hand_over.json`` and ``data/hand_over/search.csv``."""
    params = load_study()
    pairs = [pair for family in params.scenes.families for pair in study_pairs("validation", family)]
    best, trials = search_hand_overs(
        pairs,
        inputs=params.evaluate.inputs_by_estimator,
        params=params.hand_over,
        files=model_files(Path("models"), params.evaluate.all_inputs),
        workers=default_workers(),
        store=Path("data/.tasks/validation"),
    )
    Path("models").mkdir(exist_ok=True)
    save_hand_overs(Path("models/hand_over.json"), chosen_hand_overs(best))
    rows = [trial.row(trial is best[trial.estimator, trial.input]) for trial in trials]
    write_rows(rows, Path("data/hand_over/search.csv"))


if __name__ == "__main__":
    main()
