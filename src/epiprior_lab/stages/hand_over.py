"""Stage `hand_over`: how matches are handed to each estimator, chosen on validation scenes."""

from pathlib import Path

from epiprior.estimators.handover import INPUTS, save_hand_overs
from epiprior_lab.evaluation.inputs import model_files
from epiprior_lab.evaluation.protocol import MODELS, rendered_pairs
from epiprior_lab.evaluation.records import write_frame
from epiprior_lab.params import load_study
from epiprior_lab.selection.hand_over_search import search_hand_overs, trial_table


def main() -> None:
    """Write ``models/hand_over.json`` and ``data/hand_over/search.csv``."""
    params = load_study()
    inputs = {
        estimator: tuple(name for name in names if name in INPUTS)
        for estimator, names in params.evaluate.inputs_by_estimator.items()
    }
    pairs = [pair for pairs in rendered_pairs("validation", params.scenes.families).values() for pair in pairs]
    files, store = model_files(MODELS, INPUTS), Path("data/.tasks/validation")
    best, trials = search_hand_overs(pairs, inputs=inputs, params=params.hand_over, files=files, store=store)
    MODELS.mkdir(exist_ok=True)
    chosen = {estimator: {name: best[estimator, name].how for name in names} for estimator, names in inputs.items()}
    save_hand_overs(MODELS / "hand_over.json", chosen)
    write_frame(trial_table(best, trials), Path("data/hand_over/search.csv"))


if __name__ == "__main__":
    main()
