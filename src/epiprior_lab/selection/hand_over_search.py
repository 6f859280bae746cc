"""How matches are best handed to each estimator, chosen on validation scenes only.

A coordinate-wise search: the settings of a hand-over are varied one after the other, the others staying at the best
found so far. It begins at the hand-over that the library would use without a search, and leaves it only for gains above
their standard error over the pairs: with few pairs and many variations, the best score alone is mostly the luckiest.
Baselines are searched as carefully as ranked matches. Matching is done once per pair; every step is then one task per
pair and estimator, and measures F alone: its status, support and plausibility, half of the time, decide nothing here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from epiprior.estimators.handover import HandOver, default_hand_over, hand_over
from epiprior.estimators.run import solve
from epiprior.types import EMPTY_MAPPING, FloatArray
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import MatchFiles, PairMatches, match_folder, store_matches
from epiprior_lab.evaluation.runs import EstimatorInputs, each_run
from epiprior_lab.evaluation.statistics import area_under_success_curve
from epiprior_lab.labels.ground_truth import errors_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import HandOverParams

Place = tuple[str, str]  # estimator and input
Known = Mapping[str, tuple[HandOver, Sequence[float]]]  # per input, what was tried and its errors
Candidates = dict[str, list[tuple[str, HandOver]]]  # per estimator, by input
Coordinates = list[tuple[str, tuple[Any, ...]]]  # settings that are varied, in order, with their values

SUCCESS_PX = 10.0
STRICT_PX = 3.0

# What is varied, in this order; the first cuts the ranking, a baseline's by its own measure, the distance ratio, which
# adapts to the pair better than a number of matches does. Nothing that the paper does not print for `paper`.
_VARIED = {
    "standard": ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"),
    "snn": ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"),
    "generalized": ("top_k", "threshold_px", "one_to_one", "refine", "collect"),
    "paper-standard": ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"),
    "paper": ("top_k", "threshold_px", "one_to_one"),
    "default": ("top_k", "threshold_px", "refine", "collect", "one_to_one"),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One hand-over of one input to one estimator, tried on all validation pairs when the setting `step` was varied.

    `errors_px`, shape (P, S), holds the errors of the pairs over seeds, pixels; NaN without a fundamental matrix.
    """

    estimator: str
    input: str
    step: str
    how: HandOver
    errors_px: FloatArray

    @property
    def score(self) -> tuple[int, float]:
        """Successes below 10 px and below 3 px together, then the area under the curve of successes up to 10 px.

        Both thresholds count alike: few pairs decide, and a choice by either alone would follow their noise.
        """
        together = sum(int((self.errors_px < threshold).sum()) for threshold in (SUCCESS_PX, STRICT_PX))
        return together, round(area_under_success_curve(self.errors_px, SUCCESS_PX), 9)

    @property
    def pair_scores(self) -> FloatArray:
        """Per pair: successes below 10 px, below 3 px, and the area under the curve, in equal parts."""
        area = [area_under_success_curve(errors, SUCCESS_PX) for errors in self.errors_px]
        both = [(self.errors_px < threshold).mean(axis=1) for threshold in (SUCCESS_PX, STRICT_PX)]
        return np.asarray(np.mean([area, *both], axis=0))

    def gains_on(self, other: Self) -> bool:
        """Return whether the pairs do better than in `other`, in the mean, by more than the standard error of that."""
        gain = self.pair_scores - other.pair_scores
        error = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else 0.0
        return bool(gain.mean() > error + 1e-12)


def trial_table(best: Mapping[Place, Trial], trials: Sequence[Trial]) -> pd.DataFrame:
    """Return a row per trial: the hand-over, successes in pairs (mean over seeds), and whether it was chosen."""
    rows = []
    for trial in trials:
        pairs, seeds = trial.errors_px.shape
        counts = {f"successes_{t:g}": int((trial.errors_px < t).sum()) / seeds for t in (SUCCESS_PX, STRICT_PX)}
        rows.append(
            {"estimator": trial.estimator, "input": trial.input, "step": trial.step, **asdict(trial.how)}
            | {"pairs": pairs, **counts, "area": trial.score[1]}
            | {"chosen": trial is best[trial.estimator, trial.input]}
        )
    return pd.DataFrame(rows)


def coordinates(estimator: str, name: str, params: HandOverParams) -> Coordinates:
    """Return the settings that are varied for an estimator and input, in order, with their values."""
    values = {setting: getattr(params, setting) for setting in _VARIED[name]}
    if "top_k" in values:
        values["top_k"] = params.weighted.top_k if name == "generalized" else params.top_k_for(estimator)
    return list(values.items())


def candidate_errors(
    *,
    pair: Pair,
    matches: MatchFiles,
    estimator: str,
    candidates: Sequence[tuple[str, HandOver]],
    seeds: Sequence[int],
    known: Known = EMPTY_MAPPING,
) -> FloatArray:
    """Return the errors of all candidates of one estimator on one pair, shape (len(candidates), len(seeds)).

    Pixels, NaN without a fundamental matrix. `known` holds per input a hand-over that was tried before, and its errors:
    nothing runs again for a candidate that hands over the same matches.
    """
    points, sets = pair.control_points(), matches.read()
    found = {(name, _effect(sets, name, how)): list(before) for name, (how, before) in known.items()}
    errors = []
    for name, how in candidates:
        same = (name, _effect(sets, name, how))
        if same not in found:
            one = replace(sets, sets={name: sets.sets[name]})
            runs = each_run(solve, one, pair.pair_id, estimator=estimator, seeds=seeds, hand_overs={name: how})
            matrices = [solution.F for _, _, solution in runs]
            found[same] = [np.nan if F is None else float(errors_px(F, *points).mean()) for F in matrices]
        errors.append(found[same])
    return np.array(errors, np.float64)


def _effect(matches: PairMatches, name: str, how: HandOver) -> tuple[Any, ...]:
    """Return all that an estimate depends on: on many pairs different cuts hand over the same matches."""
    handed = [hand_over(ranked, how) for ranked in matches.sets[name]]
    content = tuple((part.feature1.tobytes(), part.feature2.tobytes()) for part in handed)
    return (how.threshold_px, how.collect, how.refine, content)


def search_hand_overs(
    pairs: Sequence[Pair],
    *,
    inputs: EstimatorInputs,
    params: HandOverParams,
    files: Sequence[Path] = (),
    workers: int = 1,
    store: Path | None = None,
) -> tuple[dict[Place, Trial], list[Trial]]:
    """Search the best hand-over of every input to every estimator on validation pairs.

    Return what the search ended at, and all trials in order. `inputs` lists for each estimator the inputs that it gets;
    `files`, the model files, decide the matches beside the pairs' own files.
    """
    used = tuple(dict.fromkeys(name for names in inputs.values() for name in names))
    varied = {(e, name): coordinates(e, name, params) for e, names in inputs.items() for name in names}
    best: dict[Place, Trial] = {}
    trials: list[Trial] = []
    with match_folder(store) as folder:
        matched = store_matches(pairs, used, folder, files=files, workers=workers, description="match validation pairs")
        for step in range(max(len(c) for c in varied.values())):
            planned, tasks = _planned(varied, best, step), []
            for estimator, candidates in planned.items():
                names = tuple(dict.fromkeys(name for name, _ in candidates))
                before = {name: best[estimator, name] for name in names if (estimator, name) in best}
                common = {"estimator": estimator, "candidates": tuple(candidates), "seeds": params.seeds}
                for k, (pair, matches) in enumerate(zip(pairs, matched, strict=True)):
                    needed = matches.only(names)
                    known = {name: (t.how, tuple(t.errors_px[k].tolist())) for name, t in before.items()}
                    payload = {"pair": pair, "matches": needed, "known": known, **common}
                    files = (*pair.files, *needed.paths.values())
                    tasks.append(Task(name=f"{pair.pair_id} {estimator} {step}", payload=payload, files=files))
            if not tasks:
                continue
            description = f"hand-over, step {step + 1}"
            errors = iter(map_tasks(candidate_errors, tasks, workers=workers, description=description, store=store))
            tried: dict[Place, list[Trial]] = {}
            for estimator, candidates in planned.items():
                stacked = np.stack([next(errors) for _ in pairs], axis=1)  # (candidates, pairs, seeds)
                for (name, how), e in zip(candidates, stacked, strict=True):
                    setting = varied[estimator, name][step][0]
                    trials.append(Trial(estimator=estimator, input=name, step=setting, how=how, errors_px=e))
                    tried.setdefault((estimator, name), []).append(trials[-1])
            for place, challengers in tried.items():
                best[place] = choose(best.get(place, challengers[0]), challengers)
    return best, trials


def _planned(varied: Mapping[Place, Coordinates], best: Mapping[Place, Trial], step: int) -> Candidates:
    """Return what is tried in a step: every value of one setting, the others as in the best trial so far."""
    planned: Candidates = {}
    for place, settings in varied.items():
        if step < len(settings):
            start = best[place].how if place in best else default_hand_over(*place)
            hows = dict.fromkeys((start, *(replace(start, **{settings[step][0]: v}) for v in settings[step][1])))
            new = [(place[1], how) for how in hows if place not in best or how != start]
            planned.setdefault(place[0], []).extend(new)
    return {estimator: candidates for estimator, candidates in planned.items() if candidates}


def choose(known: Trial, challengers: Sequence[Trial]) -> Trial:
    """Return the challenger with the highest score that gains on `known`, else `known`; of equals, the first."""
    return max((trial for trial in challengers if trial.gains_on(known)), key=lambda trial: trial.score, default=known)


def chosen_hand_overs(best: Mapping[Place, Trial]) -> dict[str, dict[str, HandOver]]:
    """Return the chosen hand-overs as ``{estimator: {input: hand-over}}``, what `save_hand_overs` writes."""
    table: dict[str, dict[str, HandOver]] = {}
    for (estimator, name), trial in best.items():
        table.setdefault(estimator, {})[name] = trial.how
    return table
