"""Stage `evaluate` of the second pipeline: all estimators on the photographs of one set."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior_lab.compute.tasks import SCHEDULER_VARIABLE, default_workers
from epiprior_lab.evaluation.estimates import HandOvers
from epiprior_lab.evaluation.photographs.evaluation import evaluate_set
from epiprior_lab.features.matching import model_files
from epiprior_lab.pairsets import read_pair_set
from epiprior_lab.params import PHOTOGRAPHS, Params, load_params


def real_hand_overs(params: Params) -> HandOvers:
    """Return the hand-over of every estimator and input: as chosen on rendered scenes, or whole."""
    chosen = load_hand_overs(Path("models/hand_over.json"))
    whole = {*(params.evaluate.whole or ()), *(params.evaluate.peers or ())}
    return {
        estimator: {name: HandOver() if name in whole else chosen[estimator][name] for name in names}
        for estimator, names in params.evaluate.inputs_and_peers.items()
    }


def main() -> None:
    """Write ``data/photographs/<set>/*.csv``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--set", required=True, dest="name")
    parser.add_argument("--scheduler", help="dask scheduler that gets the pairs, such as tcp://host:8786")
    arguments = parser.parse_args()
    name: str = arguments.name
    if arguments.scheduler:
        os.environ[SCHEDULER_VARIABLE] = arguments.scheduler
    params = load_params(PHOTOGRAPHS)
    evaluation = evaluate_set(
        read_pair_set(Path("data/real") / name).pairs,
        name=name,
        inputs=params.evaluate.inputs_and_peers,
        seeds=params.evaluate.seeds,
        hand_overs=real_hand_overs(params),
        truth=params.truth,
        measures=params.measures,
        peers=Path("data/peers") / name,
        files=model_files(Path("models"), params.evaluate.all_inputs),
        workers=default_workers(),
        store=Path("data/.tasks/photographs") / name,
    )
    evaluation.write(Path("data/photographs") / name)


if __name__ == "__main__":
    main()
