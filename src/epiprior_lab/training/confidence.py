"""Rows that the confidence is learnt from: facts of estimates on scenes that no ranker ever saw.

Estimates of several estimators on several inputs are right or wrong by the truth of their pair; those on pairs that do
not belong together, on planes, turning cameras and copies are never right. Whatever a pair is made of is in one block,
and cross-validation keeps blocks whole.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np

from epiprior.estimators.run import solve
from epiprior.types import BoolArray, Float32Array
from epiprior.verification.confidence import CONFIDENCE_TARGETS
from epiprior.verification.facts import COLUMNS, UNKNOWN
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.kinds import TRUE, KindCase, case_runs, plan_cases
from epiprior_lab.evaluation.runs import HandOvers
from epiprior_lab.labels.ground_truth import error_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import ConfidenceParams
from epiprior_lab.scenes.kinds import HOMOGRAPHIES
from epiprior_lab.training.comparison import Comparison
from epiprior_lab.training.samples import Sample, TargetRows

STRANGERS = "unrelated"
# Matches of others may lack these; a copy of each row that lacks some of them teaches what is left then.
_OPTIONAL = (("turn", "scale"), ("plausibility", "turn_like"), ("turn", "scale", "plausibility", "turn_like"))


@dataclass(frozen=True, kw_only=True)
class CaseFacts:
    """The facts of all estimates of one case: `rows`, (M, C), and which F are `right`."""

    case: KindCase
    rows: Float32Array
    right: BoolArray


def plan_blocks(pairs: Mapping[str, Sequence[Pair]], counts: Mapping[str, int], seed: int) -> list[KindCase]:
    """Return the cases of all blocks: the k-th pairs of all families are one, and `counts` are of each."""
    cases = []
    for number, row in enumerate(zip_longest(*pairs.values())):
        members = [pair for pair in row if pair is not None]
        places, block = {pair.scene: (pair,) for pair in members}, f"{number:03d}"
        every = [KindCase(name=p.pair_id, block=block, kind=TRUE, seed=seed, pair=p) for p in members]
        own = counts if len(members) > 1 else {kind: n for kind, n in counts.items() if kind in HOMOGRAPHIES}
        cases += [*every, *plan_cases(places, own, block=block, seed=seed)]
    return cases


def case_facts(
    *, case: KindCase, inputs: Mapping[str, Sequence[str]], hand_overs: HandOvers, success_px: float
) -> CaseFacts:
    """Return the facts of all estimates that gave an F."""
    _, runs = case_runs(solve, case, inputs, hand_overs)
    points = None if case.pair is None else case.pair.control_points()
    rows, right = [], []
    for _, _, found in runs:
        if found.facts is not None:
            rows.append(found.facts.row())
            right.append(points is not None and error_px(found.F, *points) < success_px)
    table = np.array(rows, np.float32).reshape(-1, len(COLUMNS))
    return CaseFacts(case=case, rows=table, right=np.array(right, np.bool_))


def collect_facts(
    cases: Sequence[KindCase],
    params: ConfidenceParams,
    hand_overs: HandOvers,
    *,
    success_px: float,
    files: Sequence[Path],
    store: Path,
) -> list[CaseFacts]:
    """Return the facts of all cases; on true pairs all estimators run, on other kinds some."""
    tasks = []
    for case in cases:
        estimators = params.estimators if case.kind == TRUE else params.kind_estimators
        inputs = {name: tuple(params.inputs) for name in estimators}
        how = {name: {kind: hand_overs[name][kind] for kind in params.inputs} for name in estimators}
        payload = {"case": case, "inputs": inputs, "hand_overs": how, "success_px": success_px}
        tasks.append(Task(name=case.name, payload=payload, files=(*case.files, *files)))
    return map_tasks(case_facts, tasks, description="facts of estimates", store=store)


def confidence_rows(facts: Sequence[CaseFacts], seed: int) -> dict[str, TargetRows]:
    """Return the rows of both targets: is F right; does a homography relate the images."""
    return {
        target: TargetRows.stack(target, columns, [_sample(found, target, seed) for found in facts if len(found.rows)])
        for target, columns in CONFIDENCE_TARGETS.items()
    }


def _sample(found: CaseFacts, target: str, seed: int) -> Sample:
    """Return the rows of a case, and as many again that lack what matches of others may lack."""
    rng = np.random.default_rng(child_seed(seed, "unknown", found.case.name))
    lacking = found.rows.copy()
    for row in lacking:
        for name in _OPTIONAL[int(rng.integers(len(_OPTIONAL)))]:
            row[COLUMNS.index(name)] = UNKNOWN
    labels = found.right if target == "confidence" else np.full(len(found.rows), found.case.kind in HOMOGRAPHIES)
    return Sample(
        scene=found.case.block,
        pair=found.case.name,
        rows=np.concatenate([found.rows, lacking])[:, [COLUMNS.index(name) for name in CONFIDENCE_TARGETS[target]]],
        labels=np.concatenate([labels, labels]),
        size=2 * len(found.rows),
    )


def least_confidence(comparison: Comparison, facts: Sequence[CaseFacts], accepted: float, floor: float) -> float:
    """Return the out-of-fold confidence that a share `accepted` of estimates on unrelated pairs exceeds, or `floor`."""
    found = comparison.grouped[comparison.exported].calibrated
    assert found is not None
    kinds = {one.case.name: one.case.kind for one in facts}
    strangers = np.repeat([kinds[str(name)] == STRANGERS for name in comparison.data.pairs], comparison.data.lengths)
    reached = float(np.quantile(found[strangers], 1.0 - accepted)) if strangers.any() else floor
    return round(max(reached, floor), 4)
