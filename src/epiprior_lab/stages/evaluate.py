"""Stage `evaluate`: estimators without and with the preprocessing step on the pairs of one group."""

from pathlib import Path

from epiprior_lab.evaluation.evaluate import evaluate
from epiprior_lab.evaluation.inputs import model_files
from epiprior_lab.evaluation.protocol import MODELS, make_protocol, pairs_of
from epiprior_lab.params import STUDY, load_params, read_arguments


def main() -> None:
    """Write ``<evaluate.out>/<group>/*.csv``."""
    arguments = read_arguments(main.__doc__, params=STUDY, group=None)
    params, group = load_params(arguments.params), str(arguments.group)
    own, protocol = params.evaluate, make_protocol(params)
    store, files = Path("data/.tasks") / Path(own.out).name / group, model_files(MODELS, protocol.all_inputs)
    evaluate(pairs_of(own, group), protocol, group=group, store=store, files=files).write(Path(own.out) / group)


if __name__ == "__main__":
    main()
