"""How matches are best handed to each estimator, chosen on validation scenes only.

A coordinate-wise search: the settings of a hand-over are varied one after the other, the others staying at
the best found so far. It begins at the hand-over that the library would use without a search, and leaves it only for
gains above their standard error over the pairs: with few pairs and many variations, the best score alone is mostly the
luckiest. Baselines are searched as carefully as ranked matches, so that neither side is a straw
man. Matching is done once per pair; every step is then one task per pair and estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.estimators.handover import HandOver, default_hand_over, hand_over
from epiprior.types import EMPTY_MAPPING, FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.estimates import EstimatorInputs, estimate_row, is_deterministic, match_folder
from epiprior_lab.evaluation.statistics import area_under_success_curve, successes
from epiprior_lab.features.matching import MatchFiles, PairMatches, store_matches
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import HandOverParams

Row = dict[str, Any]
Place = tuple[str, str]
Coordinates = list[tuple[str, tuple[Any, ...]]]

SUCCESS_PX = 10.0
STRICT_PX = 3.0

# What is varied after the cut of the ranking, in this order. Nothing that the paper does not print for `paper`.
_VARIED = {
    "standard": ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"),
    "snn": ("max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"),
    "generalized": ("top_k", "threshold_px", "one_to_one", "refine", "collect"),
    "paper": ("top_k", "threshold_px", "one_to_one"),
    "default": ("top_k", "threshold_px", "refine", "collect", "one_to_one"),
}


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One hand-over of one input to one estimator, tried on all validation pairs.

    Parameters
    ----------
    estimator, input : str
        For whom.
    step : str
        The setting that was varied.
    how : HandOver
        What was tried.
    errors_px : ndarray, shape (P, S), float64
        Errors of the pairs over seeds, pixels; NaN without a fundamental matrix.
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
        together = sum(int(successes(self.errors_px, threshold).sum()) for threshold in (SUCCESS_PX, STRICT_PX))
        return together, round(area_under_success_curve(self.errors_px, SUCCESS_PX), 9)

    def gains_on(self, other: Trial) -> bool:
        """Return whether the pairs do better than in `other`, in the mean, by more than the standard error of that.

        A pair counts by its successes below 10 px, below 3 px, and its area under the curve, in equal parts.
        """
        gain = self._pair_scores() - other._pair_scores()
        error = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else 0.0
        return bool(gain.mean() > error + 1e-12)

    def _pair_scores(self) -> FloatArray:
        area = [area_under_success_curve(errors, SUCCESS_PX) for errors in self.errors_px]
        both = [successes(self.errors_px, threshold).mean(axis=1) for threshold in (SUCCESS_PX, STRICT_PX)]
        return np.asarray(np.mean([area, *both], axis=0))

    def row(self, chosen: bool) -> Row:
        """Return a row of the report: successes are pairs, in the mean over seeds."""
        pairs, seeds = self.errors_px.shape
        return {
            "estimator": self.estimator,
            "input": self.input,
            "step": self.step,
            **asdict(self.how),
            "pairs": pairs,
            "successes_10": int(successes(self.errors_px, SUCCESS_PX).sum()) / seeds,
            "successes_3": int(successes(self.errors_px, STRICT_PX).sum()) / seeds,
            "area": self.score[1],
            "chosen": chosen,
        }


def coordinates(estimator: str, name: str, params: HandOverParams) -> Coordinates:
    """Return the settings that are varied for an estimator and input, in order, with their values.

    Parameters
    ----------
    estimator : str
        Those that weigh matches are tried with more of them.
    name : str
        One of `matching.INPUTS`. A baseline's ranking is cut by its own measure, the distance ratio, which
        adapts to the pair better than a number of matches does.
    params : HandOverParams
        The values.
    """
    values = {setting: getattr(params, setting) for setting in _VARIED[name]}
    if "top_k" in values:
        values["top_k"] = params.weighted.top_k if name == "generalized" else params.top_k_for(estimator)
    return list(values.items())


def starting_point(estimator: str, name: str) -> HandOver:
    """Return where the search begins: the hand-over that the library would use without a search."""
    return default_hand_over(estimator, name)


def candidate_errors(
    *,
    pair: Pair,
    matches: MatchFiles,
    estimator: str,
    candidates: Sequence[tuple[str, HandOver]],
    seeds: Sequence[int],
    known: Mapping[str, tuple[HandOver, Sequence[float]]] = EMPTY_MAPPING,
) -> FloatArray:
    """Return the errors of all candidates of one estimator on one pair.

    Parameters
    ----------
    pair : Pair
        Gives the control points; its id enters the seeds.
    matches : MatchFiles
        Matches of the pair.
    estimator : str
        Name in the registry.
    candidates : sequence of (input, HandOver)
        What is tried.
    seeds : sequence of int
        As in the evaluation.
    known : mapping of str to (HandOver, sequence of float)
        Per input, a hand-over that was tried before, and its errors: nothing runs again for a candidate that comes to
        the same.

    Returns
    -------
    ndarray, shape (len(candidates), len(seeds)), float64
        Pixels; NaN without a fundamental matrix.
    """
    points = pair.control_points()
    sets = matches.read()
    different = seeds[:1] if is_deterministic(estimator) else seeds
    errors = np.full((len(candidates), len(seeds)), np.nan)
    found = {(name, _effect(sets, name, how)): list(before) for name, (how, before) in known.items()}
    for i, (name, how) in enumerate(candidates):
        same = (name, _effect(sets, name, how))
        if same not in found:
            found[same] = [
                estimate_row(
                    sets,
                    points,
                    estimator=estimator,
                    input_name=name,
                    seed=child_seed(seed, pair.pair_id),
                    hand_over=how,
                )["error_px"]
                for seed in different
            ]
        errors[i] = found[same]  # a single run stands for all seeds
    return errors


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
    """Search the best hand-over of every input to every estimator.

    Parameters
    ----------
    pairs : sequence of Pair
        Validation pairs.
    inputs : mapping of str to sequence of str
        For each estimator the inputs that it gets.
    params : HandOverParams
        Seeds, and the values of each setting.
    files : sequence of Path
        The model files, which decide the matches beside the pairs' own files.
    workers, store
        As for `epiprior_lab.compute.tasks.map_tasks`.

    Returns
    -------
    best : dict of (estimator, input) to Trial
        What the search ended at.
    trials : list of Trial
        All of them, in order.
    """
    used = tuple(dict.fromkeys(name for names in inputs.values() for name in names))
    with match_folder(store) as folder:
        matched = store_matches(
            pairs, used, folder, files=files, workers=workers,
            description="match validation pairs", resume=store is not None,
        )  # fmt: skip

        def run(
            planned: Mapping[str, list[tuple[str, HandOver]]], best: Mapping[Place, Trial], step: int
        ) -> dict[str, FloatArray]:
            tasks = [
                _task(pair, matches, estimator, candidates, params.seeds, _known(best, estimator, candidates, k), step)
                for estimator, candidates in planned.items()
                for k, (pair, matches) in enumerate(zip(pairs, matched, strict=True))
            ]
            description = f"hand-over, step {step + 1}"
            errors = map_tasks(candidate_errors, tasks, workers=workers, description=description, store=store)
            n = len(pairs)
            return {name: np.stack(errors[k * n : (k + 1) * n], axis=1) for k, name in enumerate(planned)}

        return _search(inputs, params, run)


def _task(
    pair: Pair,
    matches: MatchFiles,
    estimator: str,
    candidates: list[tuple[str, HandOver]],
    seeds: Sequence[int],
    known: Mapping[str, tuple[HandOver, Sequence[float]]],
    step: int,
) -> Task:
    needed = matches.only(tuple(dict.fromkeys(name for name, _ in candidates)))
    return Task(
        name=f"{pair.pair_id} {estimator} {step}",
        payload={
            "pair": pair,
            "matches": needed,
            "estimator": estimator,
            "candidates": tuple(candidates),
            "seeds": tuple(seeds),
            "known": known,
        },
        files=(*pair.files, *needed.paths.values()),
    )


def _known(
    best: Mapping[Place, Trial], estimator: str, candidates: Sequence[tuple[str, HandOver]], pair: int
) -> dict[str, tuple[HandOver, tuple[float, ...]]]:
    """Return what `candidate_errors` is told of the best trials so far, for one pair."""
    names = {name for name, _ in candidates if (estimator, name) in best}
    trials = {name: best[estimator, name] for name in sorted(names)}
    return {name: (trial.how, tuple(trial.errors_px[pair].tolist())) for name, trial in trials.items()}


def _search(
    inputs: EstimatorInputs,
    params: HandOverParams,
    run: Callable[[Mapping[str, list[tuple[str, HandOver]]], Mapping[Place, Trial], int], dict[str, FloatArray]],
) -> tuple[dict[Place, Trial], list[Trial]]:
    """Vary one setting after the other; `run` returns errors of shape (candidates, pairs, seeds) per estimator.

    It is told the best trials so far, to which some candidates come down on some pairs.
    """
    varied = {(e, name): coordinates(e, name, params) for e, names in inputs.items() for name in names}
    best: dict[Place, Trial] = {}
    trials: list[Trial] = []
    for step in range(max(len(c) for c in varied.values())):
        planned: dict[str, list[tuple[str, HandOver]]] = {}
        for place, settings in varied.items():
            for how in _variations(place, settings, step, best.get(place)):
                planned.setdefault(place[0], []).append((place[1], how))
        tried: dict[Place, list[Trial]] = {}
        for estimator, errors in (run(planned, best, step) if planned else {}).items():
            for (name, how), e in zip(planned[estimator], errors, strict=True):
                place = (estimator, name)
                trial = Trial(estimator=estimator, input=name, step=varied[place][step][0], how=how, errors_px=e)
                trials.append(trial)
                tried.setdefault(place, []).append(trial)
        for place, challengers in tried.items():
            best[place] = choose(best.get(place, challengers[0]), challengers)
    return best, trials


def choose(known: Trial, challengers: Sequence[Trial]) -> Trial:
    """Return the challenger with the highest score of those that gain on what is known; `known` where none does.

    Of equals, the first tried.
    """
    return max((trial for trial in challengers if trial.gains_on(known)), key=lambda trial: trial.score, default=known)


def _variations(place: Place, varied: Coordinates, step: int, known: Trial | None) -> list[HandOver]:
    """Return the hand-overs of one step that were not tried before; of the first, the starting point comes first."""
    if step >= len(varied):
        return []
    setting, values = varied[step]
    start = known.how if known else starting_point(*place)
    variations = dict.fromkeys((start, *(replace(start, **{setting: value}) for value in values)))
    return [how for how in variations if known is None or how != start]


def chosen_hand_overs(best: dict[Place, Trial]) -> dict[str, dict[str, HandOver]]:
    """Return the chosen hand-overs as ``{estimator: {input: hand-over}}``, what `save_hand_overs` writes."""
    table: dict[str, dict[str, HandOver]] = {}
    for (estimator, name), trial in best.items():
        table.setdefault(estimator, {})[name] = trial.how
    return table
