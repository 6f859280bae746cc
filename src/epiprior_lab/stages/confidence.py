"""Stage `confidence`: how sure an estimate is, learnt from estimates on scenes that no ranker saw."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from epiprior.estimators.handover import load_hand_overs
from epiprior_lab.evaluation.inputs import model_files
from epiprior_lab.evaluation.protocol import MODELS, rendered_pairs
from epiprior_lab.export.confidence_folder import export_confidence
from epiprior_lab.params import load_study
from epiprior_lab.tracking import track
from epiprior_lab.training.comparison import compare
from epiprior_lab.training.confidence import collect_facts, confidence_rows, least_confidence, plan_blocks
from epiprior_lab.training.tables import write_training

OUT, STORE, NAME = Path("data/training/confidence"), Path("data/.tasks/confidence"), "confidence"
SPLIT = "confidence"
LEAST = 0.2  # below it F is wrong more often than four times in five, however few unrelated pairs come so far


def main() -> None:
    """Write ``data/training/confidence/`` and ``models/confidence/``."""
    params = load_study()
    own, hand_over = params.confidence, MODELS / "hand_over.json"
    cases = plan_blocks(rendered_pairs(SPLIT, params.scenes.families), own.kinds, own.seed)
    files = (*model_files(MODELS, own.inputs), hand_over)
    success_px = params.report.success_px
    facts = collect_facts(cases, own, load_hand_overs(hand_over), success_px=success_px, files=files, store=STORE)
    rows = confidence_rows(facts, own.seed)
    found = [compare(NAME, data, params.train, STORE) for data in rows.values()]
    write_training(OUT, found)
    least = least_confidence(found[0], facts, own.accepted_unrelated, LEAST)
    counts = dict(Counter(case.kind for case in cases))
    export_confidence(OUT, MODELS / NAME, least=least, floor=LEAST, accepted=own.accepted_unrelated, counts=counts)
    track(found, {key: str(value) for key, value in asdict(own).items()})


if __name__ == "__main__":
    main()
