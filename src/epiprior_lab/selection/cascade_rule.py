"""When an estimate without preprocessing is good enough, learnt on validation scenes: one rule for all estimators.

Every run of the evaluation exists without and with the preprocessing step, for the same pair and seed. A cascade
takes one or the other, so each rule's outcome follows from these runs; nothing is run again.

Why one rule: validation scenes are few, and a single one on which an estimator is badly fooled is three per cent of its
runs. The runs of all estimators together tell more, since rarely all are fooled at once.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from epiprior.types import BoolArray, FloatArray, Status
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.estimates import HandOvers, Row, estimator_rows, match_folder
from epiprior_lab.features.matching import WITHOUT, store_matches
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import CascadeParams

PREPROCESSED = "default"
ALL = "all"
# Nothing is spread so far: the rule where no other keeps within the tolerance.
NEVER = CascadeRule(min_spread=1_000_000, min_plausibility=1.0)


def validation_rows(
    pairs: Sequence[Pair],
    *,
    inputs: Mapping[str, Sequence[str]],
    matched: Sequence[str],
    seeds: Sequence[int],
    hand_overs: HandOvers,
    files: Sequence[Path] = (),
    workers: int = 1,
    store: Path | None = None,
) -> list[Row]:
    """Run every estimator without and with the preprocessing step.

    Parameters
    ----------
    pairs : sequence of Pair
        Validation pairs.
    inputs : mapping of str to sequence of str
        For each estimator its inputs, of which one is without preprocessing.
    matched : sequence of str
        The inputs that pairs are matched for: those of the stage whose matches lie in the same `store`, in its order.
    seeds, hand_overs, files, workers, store
        As for `epiprior_lab.evaluation.estimates.evaluate_pairs`.

    Returns
    -------
    list of dict
        Rows as in ``results.csv`` of the evaluation, without the family.
    """
    with match_folder(store) as folder:
        kept = store_matches(
            pairs, matched, folder, files=files, workers=workers, description="match", resume=store is not None
        )
        tasks = [
            Task(
                name=f"{pair.pair_id} {estimator}",
                payload={
                    "pair": pair,
                    "matches": matches.only(names),
                    "estimator": estimator,
                    "seeds": tuple(seeds),
                    "hand_overs": {name: hand_overs[estimator][name] for name in names},
                },
                files=(*pair.files, *matches.paths.values()),
            )
            for pair, matches in zip(pairs, kept, strict=True)
            for estimator, names in inputs.items()
        ]
        found = map_tasks(estimator_rows, tasks, workers=workers, description="estimate", store=store)
    rows: list[Row] = []
    for k, pair in enumerate(pairs):
        of_pair = found[k * len(inputs) : (k + 1) * len(inputs)]
        rows += [{"pair_id": pair.pair_id, "scene": pair.scene, **row} for part in of_pair for row in part]
    return rows


def paired_runs(results: pd.DataFrame) -> pd.DataFrame:
    """Return runs without preprocessing beside the same runs with it.

    Parameters
    ----------
    results : DataFrame
        Rows of the evaluation with columns ``family, pair_id, scene, estimator, input, seed, status, spread,
        plausibility, error_px``. Inputs other than `matching.WITHOUT` and ``default`` are left out.

    Returns
    -------
    DataFrame
        One row per family, pair, estimator and seed: ``status``, ``spread`` and ``plausibility`` without
        preprocessing, ``with_status`` with it, and the errors ``without_px``, ``with_px``, infinite without F. The
        verdict decides what a cascade does, not whether its F is right.
    """
    keys = ["family", "pair_id", "scene", "estimator", "seed"]
    table = results.assign(error_px=results["error_px"].fillna(np.inf))
    without = table[table["input"].isin(WITHOUT)].rename(columns={"error_px": "without_px"})
    with_step = table[table["input"] == PREPROCESSED].rename(columns={"error_px": "with_px", "status": "with_status"})
    left = without[[*keys, "status", "spread", "plausibility", "without_px"]]
    return left.merge(with_step[[*keys, "with_status", "with_px"]], on=keys, how="inner", validate="one_to_one")


def kept_runs(runs: pd.DataFrame, rules: Sequence[CascadeRule]) -> BoolArray:
    """Return which runs each rule keeps without preprocessing, shape (len(rules), len(runs))."""
    columns = [runs[name].to_list() for name in ("status", "spread", "plausibility")]
    kept = [[rule.keeps_numbers(*run) for run in zip(*columns, strict=True)] for rule in rules]
    return np.array(kept, dtype=np.bool_).reshape(len(rules), len(runs))


def cascade_errors(runs: pd.DataFrame, kept: BoolArray) -> FloatArray:
    """Return the errors of a cascade that keeps some of the runs, pixels, shape (N,).

    Where the verdict turns down what preprocessing leads to, the cascade falls back on what it had, if that is ``ok``,
    as the library does.
    """
    without, with_step = runs["without_px"].to_numpy(np.float64), runs["with_px"].to_numpy(np.float64)
    back = (runs["status"] == Status.OK) & (runs["with_status"] != Status.OK)
    return np.where(kept | back.to_numpy(np.bool_), without, with_step)


def lost_runs(runs: pd.DataFrame, kept: BoolArray, threshold_px: float) -> BoolArray:
    """Return the runs that would have succeeded, had they been preprocessed; shape of `kept`, (..., N)."""
    without, with_step = runs["without_px"].to_numpy(np.float64), runs["with_px"].to_numpy(np.float64)
    return np.asarray(kept & (with_step < threshold_px) & ~(without < threshold_px))


def candidate_rules(params: CascadeParams) -> list[CascadeRule]:
    """Return the rules that are tried, strictest first."""
    grid = itertools.product(sorted(params.min_plausibility, reverse=True), (0,))
    return [NEVER, *(CascadeRule(min_spread=spread, min_plausibility=least) for least, spread in grid)]


@dataclass(frozen=True, kw_only=True)
class LearntRule:
    """A rule and what it does on the runs it was learnt from.

    Parameters
    ----------
    rule : CascadeRule
        The choice.
    outcomes : DataFrame
        Indexed by estimator, in the order of the runs, `ALL` last; shares of the runs: ``preprocessed``, ``lost``
        (those that succeed with preprocessing and not with the cascade), and the same as ``held_out_preprocessed``
        and ``held_out_lost``, each scene under the rule that the other scenes would have chosen.
    """

    rule: CascadeRule
    outcomes: pd.DataFrame


def learn_rule(runs: pd.DataFrame, params: CascadeParams, *, success_px: float, strict_px: float) -> LearntRule:
    """Choose the rule that preprocesses least and loses no more than is tolerated, over all estimators together.

    Parameters
    ----------
    runs : DataFrame
        Of all estimators, as from `paired_runs`, on validation scenes.
    params : CascadeParams
        Values that are tried, and the tolerances: shares of all runs that may be lost. Runs that the cascade wins do
        not make up for lost ones.
    success_px, strict_px : float
        Of success, pixels: `CascadeParams.tolerance` holds at the first, where the cascade gave a wrong answer instead
        of a right one, `CascadeParams.strict_tolerance` at the second, where it mostly gave a less exact one.

    Returns
    -------
    LearntRule
        Of equals the strictest. Few pairs decide, hence a margin: the rules with the next lower value of one of the
        two must lose no more than is tolerated either.
    """
    rules = candidate_rules(params)
    kept = kept_runs(runs, rules)
    lost = np.stack([lost_runs(runs, kept, threshold) for threshold in (success_px, strict_px)])
    best = _choose(kept, lost, params)
    scenes = runs["scene"].to_numpy(str)
    held_kept, held_lost = np.zeros(len(runs), np.bool_), np.zeros(len(runs), np.bool_)
    for scene in np.unique(scenes):
        own = scenes == scene
        if own.all():
            continue
        other = _choose(kept[:, ~own], lost[:, :, ~own], params)
        held_kept[own], held_lost[own] = kept[other, own], lost[0, other, own]
    outcomes = pd.DataFrame(
        {
            "preprocessed": ~kept[best],
            "lost": lost[0, best],
            "held_out_preprocessed": ~held_kept,
            "held_out_lost": held_lost,
        }
    )
    each = outcomes.groupby(runs["estimator"].to_numpy(str), sort=False).mean()
    return LearntRule(rule=rules[best], outcomes=pd.concat([each, outcomes.mean().to_frame(ALL).T]))


def _choose(kept: BoolArray, lost: BoolArray, params: CascadeParams) -> int:
    """Return the number of the rule that keeps most of those with a margin; `kept` is (R, N), `lost` is (2, R, N)."""
    tolerances = np.array([params.tolerance, params.strict_tolerance])
    within = (lost.mean(axis=2) <= tolerances[:, None]).all(axis=0)
    grid = within[1:].reshape(len(params.min_plausibility), 1)  # strictest first, after NEVER
    safe = grid.copy()
    safe[:-1] &= grid[1:]
    safe[:, :-1] &= grid[:, 1:]
    allowed = np.append(True, safe.ravel())
    return int(np.argmax(np.where(allowed, kept.mean(axis=1), -1.0)))


def trade_off(runs: pd.DataFrame, params: CascadeParams, threshold_px: float) -> pd.DataFrame:
    """Return the candidate rules that are worth it on `runs`: none preprocesses less and loses as little.

    Returns
    -------
    DataFrame
        ``min_spread, min_plausibility, preprocessed, lost`` (shares of the runs), most preprocessed first.
    """
    rules = candidate_rules(params)
    kept = kept_runs(runs, rules)
    lost = lost_runs(runs, kept, threshold_px).mean(axis=1)
    share = 1.0 - kept.mean(axis=1)
    order = np.lexsort((share, lost))  # least lost first, of these least preprocessed first
    least = np.minimum.accumulate(share[order])
    front = order[np.flatnonzero(np.append(True, least[1:] < least[:-1]))]
    return pd.DataFrame(
        {
            "min_spread": [rules[k].min_spread for k in front],
            "min_plausibility": [rules[k].min_plausibility for k in front],
            "preprocessed": share[front],
            "lost": lost[front],
        }
    )
