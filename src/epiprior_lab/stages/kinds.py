"""Stage `kinds`: the confidence on pairs of other kinds (unrelated, planes, rotations, copies) and on true ones."""

from pathlib import Path

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import FIRST, model_files
from epiprior_lab.evaluation.kinds import case_records, places_of, plan_cases
from epiprior_lab.evaluation.protocol import MODELS, as_shipped, make_protocol, pairs_of
from epiprior_lab.evaluation.records import KindRecord, to_frame, write_frame
from epiprior_lab.params import STUDY, StudyParams, load_params, read_arguments

OUTS = {True: Path("data/kinds"), False: Path("data/real-kinds")}


def main() -> None:
    """Write ``data/kinds/kinds.csv``, of rendered scenes, or ``data/real-kinds/kinds.csv``, of photographs."""
    params = load_params(read_arguments(main.__doc__, params=STUDY).params)
    own, protocol = params.kinds, make_protocol(params)
    study = isinstance(params, StudyParams)
    out, apart = OUTS[study], params.evaluate.apart or ()
    sets = {group: pairs_of(params.evaluate, group) for group in params.evaluate.groups if group not in apart}
    cases = plan_cases(places_of(sets, by_scene=study), own.pairs, block="all", seed=own.seed)
    inputs = dict.fromkeys(own.estimators, own.inputs)
    hand_overs = {name: {kind: protocol.hand_overs[name][kind] for kind in own.inputs} for name in own.estimators}
    rule, cascaded = load_cascade_rule(MODELS / "cascade.json"), as_shipped(protocol, FIRST)
    how = {"rule": rule, "cascaded": [name for name in own.estimators if name in cascaded]}
    files = (*model_files(MODELS, own.inputs), *sorted((MODELS / "confidence").iterdir()))
    common = {"group": out.name, "inputs": inputs, "hand_overs": hand_overs, "truth": protocol.truth} | how
    tasks = [Task(name=case.name, payload={"case": case, **common}, files=(*case.files, *files)) for case in cases]
    found = map_tasks(case_records, tasks, description="kinds of pairs", store=Path("data/.tasks") / out.name)
    write_frame(to_frame(KindRecord, [record for records in found for record in records]), out / "kinds.csv")


if __name__ == "__main__":
    main()
