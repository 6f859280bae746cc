"""How matches are best handed to each estimator, chosen on validation scenes only.

A coordinate-wise search: the settings of a hand-over are varied one after the other, the others staying at the best
found so far. It begins at the hand-over that the library would use without a search, and leaves it only for gains above
their standard error over the pairs: with few pairs and many variations, the best score alone is mostly the luckiest.
Baselines are searched as carefully as ranked matches. Matching is done once per pair; every step is then one task per
pair, estimator and input, and measures F alone: its status, support and plausibility decide nothing here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from epiprior.estimators.handover import HandOver, default_hand_over, hand_over
from epiprior.estimators.run import solve
from epiprior.types import FloatArray
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import PairMatches, read_matches, store_matches
from epiprior_lab.evaluation.runs import EstimatorInputs, each_run
from epiprior_lab.evaluation.statistics import area_under_success_curve
from epiprior_lab.labels.ground_truth import error_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import HandOverParams

Place = tuple[str, str]  # estimator and input

SUCCESS_PX = 10.0
STRICT_PX = 3.0

# What is varied, in this order; the first cuts the ranking, a baseline's by its own measure, the distance ratio, which
# adapts to the pair better than a number of matches does. Nothing that the paper does not print for `paper`.
_BY_RATIO = ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect")
_VARIED = dict.fromkeys(("standard", "snn", "paper-standard"), _BY_RATIO) | {
    "generalized": ("top_k", "threshold_px", "one_to_one", "refine", "collect"),
    "paper": ("top_k", "threshold_px", "one_to_one"),
    "default": ("top_k", "threshold_px", "refine", "collect", "one_to_one"),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One hand-over of one input to one estimator, tried on all validation pairs when the setting `step` was varied.

    `errors_px`, shape (P, S), holds the errors of the pairs over seeds, pixels; NaN without a fundamental matrix.
    """

    place: Place
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
            {"estimator": trial.place[0], "input": trial.place[1], "step": trial.step, **asdict(trial.how)}
            | {"pairs": pairs, **counts, "area": trial.score[1]}
            | {"chosen": trial is best[trial.place]}
        )
    return pd.DataFrame(rows)


def coordinates(estimator: str, name: str, params: HandOverParams) -> list[tuple[str, tuple[Any, ...]]]:
    """Return the settings that are varied for an estimator and input, in order, with their values."""
    values = {setting: getattr(params, setting) for setting in _VARIED[name]}
    if "top_k" in values:
        weighted = name == "generalized" or estimator in params.weighted.estimators
        values["top_k"] = params.weighted.top_k if weighted else params.top_k
    return list(values.items())


def candidate_errors(
    *, pair: Pair, matches: Mapping[str, Path], place: Place, hows: Sequence[HandOver], seeds: Sequence[int]
) -> FloatArray:
    """Return the errors of all hand-overs of one input to one estimator on one pair, shape (len(hows), len(seeds)).

    Pixels, NaN without a fundamental matrix. `matches` holds the file of the input alone. Nothing runs again for a
    hand-over of the same matches as an earlier one.
    """
    (estimator, name), points, read = place, pair.control_points(), read_matches(matches)
    found: dict[tuple[Any, ...], list[float]] = {}
    errors = []
    for how in hows:
        same = _effect(read, name, how)
        if same not in found:
            runs = each_run(solve, read, pair.pair_id, estimator=estimator, seeds=seeds, hand_overs={name: how})
            found[same] = [error_px(solution.F, *points) for _, _, solution in runs]
        errors.append(found[same])
    return np.array(errors, np.float64)


def _effect(matches: PairMatches, name: str, how: HandOver) -> tuple[Any, ...]:
    """Return all that an estimate depends on: on many pairs different cuts hand over the same matches."""
    handed = [hand_over(ranked, how) for ranked in matches.sets[name]]
    content = tuple((part.feature1.tobytes(), part.feature2.tobytes()) for part in handed)
    return (how.threshold_px, how.collect, how.refine, content)


def search_hand_overs(
    pairs: Sequence[Pair], *, inputs: EstimatorInputs, params: HandOverParams, files: Sequence[Path], store: Path
) -> tuple[dict[Place, Trial], list[Trial]]:
    """Search the best hand-over of every input to every estimator on validation pairs.

    Return what the search ended at, and all trials in order. `inputs` lists for each estimator the inputs that it gets;
    `files`, the model files, decide the matches beside the pairs' own files.
    """
    varied = {(e, name): coordinates(e, name, params) for e, names in inputs.items() for name in names}
    used = tuple(dict.fromkeys(name for _, name in varied))
    matched = store_matches(pairs, used, store / "matches", files=files, description="match validation pairs")
    best: dict[Place, Trial] = {}
    trials: list[Trial] = []
    for step in range(max(map(len, varied.values()))):
        planned: dict[Place, list[HandOver]] = {}
        tasks = []
        for place, settings in varied.items():
            if step >= len(settings):
                continue
            setting, values = settings[step]
            start = best[place].how if step else default_hand_over(*place)
            every = dict.fromkeys((start, *(replace(start, **{setting: value}) for value in values)))
            planned[place] = [how for how in every if not step or how != start]
            common = {"place": place, "hows": planned[place], "seeds": params.seeds}
            for pair, found in zip(pairs, matched, strict=True):
                name, path = f"{pair.pair_id} {' '.join(place)} {step}", found[place[1]]
                payload = {"pair": pair, "matches": {place[1]: path}, **common}
                tasks.append(Task(name=name, payload=payload, files=(*pair.files, path)))
        errors = iter(map_tasks(candidate_errors, tasks, description=f"hand-over, step {step + 1}", store=store))
        for place, hows in planned.items():
            of_pairs = np.stack([next(errors) for _ in pairs], axis=1)  # (hand-overs, pairs, seeds)
            both, setting = zip(hows, of_pairs, strict=True), varied[place][step][0]
            tried = [Trial(place=place, step=setting, how=how, errors_px=own) for how, own in both]
            trials += tried
            best[place] = choose(best[place] if step else tried[0], tried)
    return best, trials


def choose(known: Trial, challengers: Sequence[Trial]) -> Trial:
    """Return the challenger with the highest score that gains on `known`, else `known`; of equals, the first."""
    return max((trial for trial in challengers if trial.gains_on(known)), key=lambda trial: trial.score, default=known)
