"""Every estimator on every input of every photographed pair, measured in every way that the pair's truth allows.

Matches are made once per pair and kept in files; rankings and each estimator of each pair are tasks of their own,
so that a run that was killed continues where it stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.estimates import EstimatorInputs, HandOvers, match_folder, write_rows
from epiprior_lab.evaluation.photographs.estimation import photograph_rows
from epiprior_lab.evaluation.photographs.estimator_code import estimator_code
from epiprior_lab.evaluation.photographs.facts import PairFacts, pair_facts
from epiprior_lab.evaluation.photographs.peers import store_peer_matches
from epiprior_lab.features.matching import INPUTS, MatchFiles, store_matches
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import MeasureParams, TruthParams

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class SetEvaluation:
    """Rows of one set; each field becomes one CSV file of the field's name, led by set, pair id and scene.

    Parameters
    ----------
    pairs : list of dict
        One row per pair, see `facts.PairFacts`.
    results : list of dict
        One row per pair, estimator, input and seed, see `estimation.photograph_rows`.
    rankings, ranking_curves, calibration : list of dict
        As in the study; only pairs with labels have rows.
    """

    pairs: list[Row]
    results: list[Row]
    rankings: list[Row]
    ranking_curves: list[Row]
    calibration: list[Row]

    def write(self, folder: Path) -> None:
        """Write the files to `folder`, made if absent."""
        for f in fields(self):
            write_rows(getattr(self, f.name), folder / f"{f.name}.csv")


def evaluate_set(
    pairs: Sequence[Pair],
    *,
    name: str,
    inputs: EstimatorInputs,
    seeds: Sequence[int],
    hand_overs: HandOvers,
    truth: TruthParams,
    measures: MeasureParams,
    peers: Path | None = None,
    files: Sequence[Path] = (),
    workers: int = 1,
    store: Path | None = None,
) -> SetEvaluation:
    """Evaluate the pairs of one set in parallel; a run that was killed continues.

    Parameters
    ----------
    pairs : sequence of Pair
        Pairs of one set.
    name : str
        Of the set; it leads every row, followed by pair id and scene.
    inputs : mapping of str to sequence of str
        For each estimator the inputs that it gets; what is not in `matching.INPUTS` is a peer's.
    seeds, hand_overs, measures
        As for `photograph_rows` (with the estimator first: ``hand_overs[estimator][input]``).
    truth : TruthParams
        As for `pair_facts`.
    peers : Path, optional
        Folder of the peers' matches for this set, see `epiprior_lab.evaluation.photographs.peers`.
    files : sequence of Path
        What decides every pair beside its own images: the model files.
    workers, store
        As for `epiprior_lab.compute.tasks.map_tasks`.
    """
    used = tuple(dict.fromkeys(name for names in inputs.values() for name in names))
    own = tuple(name for name in used if name in INPUTS)
    codes = {estimator: estimator_code(estimator) for estimator in inputs}
    with match_folder(store) as folder:
        matched = store_matches(
            pairs, own, folder, files=files, workers=workers, description=f"match {name}", resume=store is not None
        )
        matched = store_peer_matches(pairs, matched, [other for other in used if other not in INPUTS], peers, folder)
        facts: list[PairFacts] = map_tasks(
            pair_facts,
            [
                _task(pair.pair_id, pair, matches, {"truth": truth})
                for pair, matches in zip(pairs, matched, strict=True)
            ],
            workers=workers,
            description=f"rankings of {name}",
            store=store,
        )
        results = map_tasks(
            photograph_rows,
            [
                _task(
                    f"{pair.pair_id} {estimator}",
                    pair,
                    matches.only(names),
                    {
                        "truth": found.truth,
                        "estimator": estimator,
                        "code": codes[estimator],
                        "seeds": tuple(seeds),
                        "hand_overs": {name: hand_overs[estimator][name] for name in names},
                        "measures": measures,
                    },
                )
                for pair, matches, found in zip(pairs, matched, facts, strict=True)
                for estimator, names in inputs.items()
            ],
            workers=workers,
            description=f"estimate {name}",
            store=store,
        )
    return _joined(name, pairs, facts, [results[k : k + len(inputs)] for k in range(0, len(results), len(inputs))])


def _task(name: str, pair: Pair, matches: MatchFiles, settings: Row) -> Task:
    files = (*pair.files, *matches.paths.values())
    return Task(name=name, payload={"pair": pair, "matches": matches, **settings}, files=files)


def _joined(
    name: str, pairs: Sequence[Pair], facts: Sequence[PairFacts], results: Sequence[list[list[Row]]]
) -> SetEvaluation:
    whole = SetEvaluation(pairs=[], results=[], rankings=[], ranking_curves=[], calibration=[])
    for pair, found, of_pair in zip(pairs, facts, results, strict=True):
        key = {"set": name, "pair_id": pair.pair_id, "scene": pair.scene}
        whole.pairs.append(key | found.pair)
        whole.results.extend(key | row for rows in of_pair for row in rows)
        for part in ("rankings", "ranking_curves", "calibration"):
            getattr(whole, part).extend(key | row for row in getattr(found, part))
    return whole
