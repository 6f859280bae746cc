"""Estimators before and after preprocessing on the pairs of one set (paper, "General performance").

Matches are made once per pair and kept in files, then rankings are labelled and every estimator runs on its inputs.
Each pair, and each pair and estimator, is a task of its own.
"""

from collections.abc import Sequence
from pathlib import Path

from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import match_folder, store_matches
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.rankings import pair_records
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.evaluation.runs import run_pairs
from epiprior_lab.pairsets import Pair


def evaluate(
    pairs: Sequence[Pair],
    protocol: Protocol,
    *,
    group: str,
    workers: int = 1,
    store: Path | None = None,
    files: Sequence[Path] = (),
) -> Tables:
    """Evaluate the pairs of one set, each with ground truth, in parallel; a run that was killed continues.

    `group`, the name of the set, leads every row. `files` decide every pair beside its own images: the model files.
    `workers` and `store` are as for `epiprior_lab.compute.tasks.map_tasks`.
    """
    with match_folder(store) as folder:
        matched = store_matches(
            pairs,
            protocol.all_inputs,
            folder,
            peers=None if protocol.peers is None else protocol.peers / group,
            files=files,
            workers=workers,
            description=f"match {group}",
        )
        tasks = [
            Task(
                name=pair.pair_id,
                payload={"pair": pair, "matches": matches, "group": group, "truth": protocol.truth},
                files=(*pair.files, *matches.paths.values()),
            )
            for pair, matches in zip(pairs, matched, strict=True)
        ]
        described = map_tasks(pair_records, tasks, workers=workers, description=f"rankings of {group}", store=store)
        runs = run_pairs(
            pairs,
            matched,
            group=group,
            inputs=protocol.inputs,
            seeds=protocol.seeds,
            hand_overs=protocol.hand_overs,
            truth=protocol.truth,
            measures=protocol.measures,
            workers=workers,
            store=store,
        )
    return Tables.from_records([*(record for records in described for record in records), *runs])
