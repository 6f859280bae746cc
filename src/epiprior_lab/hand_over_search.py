"""How matches are best handed to each estimator, chosen on validation scenes only.

A coordinate-wise search: the settings of a hand-over are varied one after the other, the others staying at
the best found so far. Baselines are searched as carefully as ranked matches, so that neither side is a straw
man. Matching is done once per pair; every round is then one task per pair over all estimators and inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.handover import HandOver, hand_over
from epiprior.types import FloatArray
from epiprior_lab.datasets import Pair
from epiprior_lab.evaluation import BASELINES, PairMatches, estimate_row, match_pair
from epiprior_lab.parallel import Task, map_tasks
from epiprior_lab.params import HandOverParams
from epiprior_lab.seeds import child_seed
from epiprior_lab.statistics import area_under_success_curve, successes

Row = dict[str, Any]
Place = tuple[str, str]

SUCCESS_PX = 10.0
STRICT_PX = 3.0


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
    def score(self) -> tuple[int, int, float]:
        """Successes below 10 px, then below 3 px, then the area under the curve of successes up to 10 px."""
        return (
            int(successes(self.errors_px, SUCCESS_PX).sum()),
            int(successes(self.errors_px, STRICT_PX).sum()),
            round(area_under_success_curve(self.errors_px, SUCCESS_PX), 9),
        )

    def row(self, chosen: bool) -> Row:
        """Return a row of the report: successes are pairs, in the mean over seeds."""
        loose, strict, area = self.score
        pairs, seeds = self.errors_px.shape
        return {
            "estimator": self.estimator,
            "input": self.input,
            "step": self.step,
            **asdict(self.how),
            "pairs": pairs,
            "successes_10": loose / seeds,
            "successes_3": strict / seeds,
            "area": area,
            "chosen": chosen,
        }


def coordinates(name: str, params: HandOverParams) -> list[tuple[str, tuple[Any, ...]]]:
    """Return the settings that are varied for an input, in order, with their values.

    Parameters
    ----------
    name : str
        ``standard``, ``snn``, ``paper`` or ``default``.
    params : HandOverParams
        The values.
    """
    cut = ("max_distance_ratio",) if name in BASELINES else ("top_k", "min_probability")
    rest = {
        "standard": ("threshold_px", "top_k", "one_to_one", "refine"),
        "snn": ("threshold_px", "top_k", "one_to_one", "refine"),
        "paper": ("threshold_px", "one_to_one"),  # nothing that is not printed
        "default": ("threshold_px", "refine", "collect", "spread", "one_to_one"),
    }
    return [(setting, getattr(params, setting)) for setting in (*cut, *rest[name])]


def starting_point(name: str, params: HandOverParams) -> HandOver:
    """Return where the search begins: all matches for the baselines, some of the best otherwise."""

    def middle(values: Sequence[Any]) -> Any:
        return values[len(values) // 2]

    baseline = name in BASELINES
    return HandOver(
        one_to_one=params.one_to_one[0],
        top_k=None if baseline else middle(params.top_k),
        max_distance_ratio=middle(params.max_distance_ratio) if baseline else None,
        threshold_px=middle(params.threshold_px),
        collect=name == "default",
        refine=name == "default",
    )


def candidate_errors(
    pair_id: str,
    points: tuple[FloatArray, FloatArray],
    matches: PairMatches,
    candidates: Sequence[tuple[str, str, HandOver]],
    seeds: Sequence[int],
) -> FloatArray:
    """Return the errors of all candidates on one pair.

    Parameters
    ----------
    pair_id : str
        Enters the seeds.
    points : tuple of ndarray, shape (N, 2), float64
        Control points of the pair, pixels.
    matches : PairMatches
        Matches of the pair.
    candidates : sequence of (estimator, input, HandOver)
        What is tried.
    seeds : sequence of int
        As in the evaluation.

    Returns
    -------
    ndarray, shape (len(candidates), len(seeds)), float64
        Pixels; NaN without a fundamental matrix.
    """
    errors = np.full((len(candidates), len(seeds)), np.nan)
    known: dict[tuple[Any, ...], FloatArray] = {}
    for i, (estimator, name, how) in enumerate(candidates):
        same = (estimator, name, _effect(matches, name, how))
        if same not in known:
            rows = (
                estimate_row(
                    matches,
                    points,
                    estimator=estimator,
                    input_name=name,
                    seed=child_seed(seed, pair_id),
                    hand_over=how,
                )
                for seed in seeds
            )
            known[same] = np.array([row["error_px"] for row in rows])
        errors[i] = known[same]
    return errors


def _effect(matches: PairMatches, name: str, how: HandOver) -> tuple[Any, ...]:
    """Return all that an estimate depends on: on many pairs different cuts hand over the same matches."""
    handed = [hand_over(ranked, how) for ranked in matches.sets[name]]
    content = tuple((part.feature1.tobytes(), part.feature2.tobytes()) for part in handed)
    return (how.threshold_px, how.collect, how.refine, content)


def search_hand_overs(
    pairs: Sequence[Pair],
    *,
    estimators: Sequence[str],
    inputs: Sequence[str],
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
    estimators, inputs : sequence of str
        Names.
    params : HandOverParams
        Seeds, and the values of each setting.
    files : sequence of Path
        The model files, which decide the matches beside the pairs' own files.
    workers, store
        As for `epiprior_lab.parallel.map_tasks`.

    Returns
    -------
    best : dict of (estimator, input) to Trial
        The trial with the highest score; of equals the first tried.
    trials : list of Trial
        All of them, in order.
    """
    tasks = [
        Task(
            name=pair.pair_id,
            payload={"pair": pair, "inputs": tuple(inputs)},
            files=(*pair.files, *files),
        )
        for pair in pairs
    ]
    matched = map_tasks(match_pair, tasks, workers=workers, description="match validation pairs", store=store)
    points = [pair.control_points() for pair in pairs]

    def run(candidates: list[tuple[str, str, HandOver]], step: int) -> FloatArray:
        tasks = [
            Task(
                name=f"{pair.pair_id} {step}",
                payload={
                    "pair_id": pair.pair_id,
                    "points": xy,
                    "matches": matches,
                    "candidates": tuple(candidates),
                    "seeds": params.seeds,
                },
            )
            for pair, xy, matches in zip(pairs, points, matched, strict=True)
        ]
        description = f"hand-over, step {step + 1}"
        errors = map_tasks(candidate_errors, tasks, workers=workers, description=description, store=store)
        return np.stack(errors, axis=1)

    places = [(estimator, name) for estimator in estimators for name in inputs]
    varied = {name: coordinates(name, params) for name in inputs}
    best: dict[Place, Trial] = {}
    trials: list[Trial] = []
    for step in range(max(len(c) for c in varied.values())):
        planned = [
            (place, setting, how)
            for place in places
            for setting, how in _variations(varied[place[1]], step, place, best, params)
        ]
        if not planned:
            continue
        errors = run([(*place, how) for place, _, how in planned], step)
        for (place, setting, how), e in zip(planned, errors, strict=True):
            trial = Trial(estimator=place[0], input=place[1], step=setting, how=how, errors_px=e)
            trials.append(trial)
            if place not in best or trial.score > best[place].score:
                best[place] = trial
    return best, trials


def _variations(
    varied: list[tuple[str, tuple[Any, ...]]],
    step: int,
    place: Place,
    best: dict[Place, Trial],
    params: HandOverParams,
) -> list[tuple[str, HandOver]]:
    """Return the hand-overs of one step that were not tried before."""
    if step >= len(varied):
        return []
    setting, values = varied[step]
    known = best.get(place)
    start = known.how if known else starting_point(place[1], params)
    tried = {start} if known else set()
    if setting == "spread" and start.top_k is None:
        return []  # spread is a share of top_k
    variations = (replace(start, **{setting: value}) for value in values)
    return [(setting, how) for how in dict.fromkeys(variations) if how not in tried]


def chosen_hand_overs(best: dict[Place, Trial]) -> dict[str, dict[str, HandOver]]:
    """Return the chosen hand-overs as ``{estimator: {input: hand-over}}``, what `save_hand_overs` writes."""
    table: dict[str, dict[str, HandOver]] = {}
    for (estimator, name), trial in best.items():
        table.setdefault(estimator, {})[name] = trial.how
    return table
