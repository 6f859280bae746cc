"""Stage `evaluate`: estimators without and with the preprocessing step on the pairs of one group."""

import argparse
import os
from pathlib import Path
from typing import Any

from epiprior_lab.compute.tasks import SCHEDULER_VARIABLE, default_workers
from epiprior_lab.evaluation.evaluate import evaluate
from epiprior_lab.evaluation.inputs import model_files
from epiprior_lab.evaluation.protocol import MODELS, make_protocol, pairs_of
from epiprior_lab.params import STUDY, load_params


def main() -> None:
    """Write ``<evaluate.out>/<group>/*.csv``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--params", type=Path, default=STUDY)
    parser.add_argument("--group", required=True)
    parser.add_argument("--scheduler", help="dask scheduler that gets the pairs, such as tcp://host:8786")
    arguments = parser.parse_args()
    if arguments.scheduler:
        os.environ[SCHEDULER_VARIABLE] = arguments.scheduler
    params, group = load_params(arguments.params), str(arguments.group)
    own, protocol = params.evaluate, make_protocol(params)
    store, files = Path("data/.tasks") / Path(own.out).name / group, model_files(MODELS, protocol.all_inputs)
    how: dict[str, Any] = {"group": group, "workers": default_workers(), "store": store, "files": files}
    evaluate(pairs_of(own, group), protocol, **how).write(Path(own.out) / group)


if __name__ == "__main__":
    main()
