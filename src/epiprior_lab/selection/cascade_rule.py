"""When an estimate on simple matches is good enough, learnt on validation scenes: one rule for all estimators.

Every run of the evaluation exists on simple matches and on ranked ones, for the same pair and seed. A cascade
takes one or the other, so each rule's outcome follows from these runs; nothing is run again. The runs of all estimators
together choose one rule, since validation scenes are few, and rarely are all estimators wrong on one at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from epiprior.types import BoolArray, FloatArray
from epiprior.verification.cascade import CascadeRule, says_more
from epiprior_lab.evaluation.inputs import FIRST, PREPROCESSED
from epiprior_lab.params import CascadeParams

ALL = "all"
NEVER = CascadeRule(min_confidence=1.0)  # where no other rule keeps within the tolerance


def paired_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs on simple matches beside the same runs on ranked ones; other inputs are left out.

    One row per group, pair, estimator and seed: ``status, geometry, confidence, error_px`` of the first, the same as
    ``with_...`` of the second; the errors are infinite without F, whatever the status.
    """
    keys = ["group", "pair_id", "scene", "estimator", "seed"]
    said = ["status", "geometry", "confidence", "error_px"]
    table = runs.assign(error_px=runs["error_px"].fillna(np.inf))[[*keys, "input", *said]]
    first, second = (table[table["input"] == name].drop(columns="input") for name in (FIRST, PREPROCESSED))
    second = second.rename(columns={name: f"with_{name}" for name in said})
    return first.merge(second, on=keys, how="inner", validate="one_to_one")


def kept_runs(runs: pd.DataFrame, rules: Sequence[CascadeRule]) -> BoolArray:
    """Return which runs each rule keeps without preprocessing, shape (len(rules), len(runs))."""
    numbers = list(zip(runs["status"], runs["geometry"], runs["confidence"], strict=True))
    kept = [[rule.keeps_numbers(*run) for run in numbers] for rule in rules]
    return np.array(kept, dtype=np.bool_).reshape(len(rules), len(runs))


def cascade_errors(runs: pd.DataFrame, kept: BoolArray) -> FloatArray:
    """Return the errors of a cascade that keeps some of the runs, pixels, shape (N,).

    As in the library, the cascade falls back on its first estimate where that says more.
    """
    firsts, seconds = (zip(runs[f"{w}status"], runs[f"{w}geometry"], strict=True) for w in ("", "with_"))
    back = [says_more(first, second) for first, second in zip(firsts, seconds, strict=True)]
    return np.where(kept | np.array(back, np.bool_), runs["error_px"], runs["with_error_px"])


def lost_runs(runs: pd.DataFrame, kept: BoolArray, threshold_px: float) -> BoolArray:
    """Return the runs that would have succeeded, had they been preprocessed; shape of `kept`, (..., N)."""
    first, second = runs["error_px"].to_numpy(np.float64), runs["with_error_px"].to_numpy(np.float64)
    return np.asarray(kept & (second < threshold_px) & ~(first < threshold_px))


def candidate_rules(params: CascadeParams) -> list[CascadeRule]:
    """Return the rules that are tried, strictest first."""
    return [NEVER, *(CascadeRule(min_confidence=least) for least in sorted(params.min_confidence, reverse=True))]


@dataclass(frozen=True, kw_only=True)
class LearntRule:
    """A rule and what it does on the runs it was learnt from.

    `outcomes` is indexed by estimator, in the order of the runs, `ALL` last; it holds shares of the runs:
    ``preprocessed``, ``lost`` (those that succeed with preprocessing and not with the cascade), and the same as
    ``held_out_preprocessed`` and ``held_out_lost``, each scene under the rule that the other scenes would have chosen.
    """

    rule: CascadeRule
    outcomes: pd.DataFrame


def learn_rule(runs: pd.DataFrame, params: CascadeParams, *, success_px: float, strict_px: float) -> LearntRule:
    """Choose the rule that preprocesses least and loses no more than is tolerated, over all estimators together.

    `runs` are those of `paired_runs` on validation scenes. At `success_px`, where the cascade gave a wrong answer
    instead of a right one, `CascadeParams.tolerance` is the share of all runs that may be lost; at `strict_px`, where
    it mostly gave a less exact one, `CascadeParams.strict_tolerance`. Runs that the cascade wins do not make up for
    lost ones. Of equals the strictest. Few pairs decide, hence a margin: the next lower value must be tolerable too.
    """
    rules = candidate_rules(params)
    kept = kept_runs(runs, rules)
    lost = np.stack([lost_runs(runs, kept, threshold) for threshold in (success_px, strict_px)])
    tolerances = np.array([[params.tolerance], [params.strict_tolerance]])

    def choose(member: BoolArray) -> int:
        within = (lost[:, :, member].mean(axis=2) <= tolerances).all(axis=0)
        safe = within & np.append(within[1:], True)
        safe[0] = True
        return int(np.argmax(np.where(safe, kept[:, member].mean(axis=1), -1.0)))

    best = choose(np.ones(len(runs), np.bool_))
    scenes = runs["scene"].to_numpy(str)
    held_kept, held_lost = np.zeros(len(runs), np.bool_), np.zeros(len(runs), np.bool_)
    for scene in np.unique(scenes):
        own = scenes == scene
        if not own.all():
            other = choose(~own)
            held_kept[own], held_lost[own] = kept[other, own], lost[0, other, own]
    chosen = {"preprocessed": ~kept[best], "lost": lost[0, best]}
    outcomes = pd.DataFrame({**chosen, "held_out_preprocessed": ~held_kept, "held_out_lost": held_lost})
    each = outcomes.groupby(runs["estimator"].to_numpy(str), sort=False).mean()
    return LearntRule(rule=rules[best], outcomes=pd.concat([each, outcomes.mean().to_frame(ALL).T]))


def trade_off(runs: pd.DataFrame, params: CascadeParams, threshold_px: float) -> pd.DataFrame:
    """Return ``preprocessed`` and ``lost``, shares of the runs, of all candidate rules, most preprocessed first."""
    kept = kept_runs(runs, candidate_rules(params))
    lost = lost_runs(runs, kept, threshold_px).mean(axis=1)
    return pd.DataFrame({"preprocessed": 1.0 - kept.mean(axis=1), "lost": lost})
