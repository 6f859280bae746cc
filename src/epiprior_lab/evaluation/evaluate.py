"""Estimators before and after preprocessing on the pairs of one set (paper, "General performance").

Matches are made once per pair and kept in files, then rankings are labelled and every estimator runs on its inputs.
Each pair, and each pair and estimator, is a task of its own.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import store_matches
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.rankings import pair_records
from epiprior_lab.evaluation.records import RunRecord, Tables
from epiprior_lab.evaluation.runs import run_pair
from epiprior_lab.pairsets import Pair


def evaluate(
    pairs: Sequence[Pair], protocol: Protocol, *, group: str, store: Path, files: Sequence[Path] = ()
) -> Tables:
    """Evaluate the pairs of one set, each with ground truth, in parallel; a run that was killed continues.

    `group`, the name of the set, leads every row. `files` decide every pair beside its own images: the model files.
    `store` is as for `epiprior_lab.compute.tasks.map_tasks`, and keeps the matches as well.
    """
    how: dict[str, Any] = {"peers": protocol.peers / group, "files": files, "description": f"match {group}"}
    matched = store_matches(pairs, protocol.all_inputs, store / "matches", **how)
    tasks = []
    for pair, matches in zip(pairs, matched, strict=True):
        payload = {"pair": pair, "matches": matches, "group": group, "truth": protocol.truth}
        tasks.append(Task(name=pair.pair_id, payload=payload, files=(*pair.files, *matches.values())))
    described = map_tasks(pair_records, tasks, description=f"rankings of {group}", store=store)
    runs = run_pairs(pairs, matched, protocol, group=group, store=store)
    return Tables.from_records([*(record for records in described for record in records), *runs])


def run_pairs(
    pairs: Sequence[Pair], matched: Sequence[Mapping[str, Path]], protocol: Protocol, *, group: str, store: Path
) -> list[RunRecord]:
    """Run every estimator on its inputs of every pair in parallel: one task per pair and estimator.

    `pairs` and `matched` are in one order; `store` is as for `epiprior_lab.compute.tasks.map_tasks`.
    """
    common = {"group": group, "seeds": protocol.seeds, "truth": protocol.truth, "measures": protocol.measures}
    tasks = []
    for pair, matches in zip(pairs, matched, strict=True):
        for estimator, names in protocol.inputs.items():
            needed = {name: matches[name] for name in names}
            hand_overs = {name: protocol.hand_overs[estimator][name] for name in names}
            own = {"pair": pair, "matches": needed, "estimator": estimator, "hand_overs": hand_overs}
            files = (*pair.files, *needed.values())
            tasks.append(Task(name=f"{pair.pair_id} {estimator}", payload=own | common, files=files))
    found = map_tasks(run_pair, tasks, description=f"estimate {group}", store=store)
    return [record for records in found for record in records]
