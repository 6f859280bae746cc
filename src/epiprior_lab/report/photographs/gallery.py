"""The hardest rescued and the lost pairs: best matches and epipolar lines in both images, before and after.

Photographs may not be passed on. So every picture exists twice: on the photographs, in a folder that stays here, and
on blank frames of the same size, for the page that is committed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture
from epiprior.features.images import Image
from epiprior.types import BoolArray, FloatArray, FundamentalEstimate, MatchSet, Status
from epiprior_lab.evaluation.estimates import HandOvers
from epiprior_lab.evaluation.photographs.estimation import run_estimator
from epiprior_lab.evaluation.photographs.params import GalleryParams
from epiprior_lab.features.matching import match_pair
from epiprior_lab.pairsets import Pair
from epiprior_lab.report.photographs.results import OURS, Photographs, error_runs

RESCUED, LOST = "rescued", "lost"
WITHOUT_STEP, SNN = "without", "snn"  # what ours is compared with
_BLANK = 235
_SETTINGS = DrawSettings(max_matches=60, max_panel_size=560)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A pair that is shown.

    Parameters
    ----------
    kind : str
        `RESCUED` or `LOST`.
    set_name, pair_id : str
        Which pair.
    split : str
        How hard it is.
    right_share : float
        Of X_L.
    estimator : str
        Whose runs are drawn.
    inputs : tuple of str
        What is compared with ours, and ours.
    changed, of : int
        Of so many estimators, how many change sides in the same way.
    succeeded : tuple of float
        Shares of the runs of `estimator`, of both inputs.
    seeds : tuple of int
        Run with the median error, of both inputs: what is drawn.
    verdicts : tuple of str
        Status of these runs.
    """

    kind: str
    set_name: str
    pair_id: str
    split: str
    right_share: float
    estimator: str
    inputs: tuple[str, str]
    changed: int
    of: int
    succeeded: tuple[float, float]
    seeds: tuple[int, int]
    verdicts: tuple[str, str]

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.kind}-{self.set_name}-{self.pair_id}"


def choose_cases(
    photographs: Photographs, params: GalleryParams, *, success_px: float, seeds: Sequence[int]
) -> list[Case]:
    """Return the pairs to show.

    Parameters
    ----------
    photographs : Photographs
        Results.
    params : GalleryParams
        Estimator and numbers of pairs.
    success_px : float
        Of success, pixels.
    seeds : sequence of int
        Of the runs, in their order.

    Returns
    -------
    list of Case
        Rescued: most runs of the estimator fail without preprocessing and succeed with it, and the run that is drawn
        with it has the verdict `ok`; those with the fewest right matches in X_L first. Lost: the reverse, by as many
        estimators as possible, against the input without preprocessing or against `snn`, whichever more of them lose
        against; drawn is the estimator of `params` where it is among them, otherwise the one that loses most runs.
        Only pairs that count in the total.
    """
    runs = _Runs(photographs, success_px, seeds)
    pairs = photographs.pairs[["set", "pair_id", "pair", "split", "right_share"]].reset_index(drop=True)
    pairs["rank"] = pairs["right_share"].fillna(1.0)
    counted = pairs["pair"].isin(photographs.counted)
    rescued: list[Case] = []
    for place, row in pairs[counted].sort_values(["rank", "pair"]).iterrows():
        case = runs.case(RESCUED, row, int(str(place)), params.estimator, WITHOUT_STEP)
        if case.succeeded[0] < 0.5 < case.succeeded[1] and case.verdicts[1] == Status.OK:
            rescued.append(case)
    numbers = {against: np.sum(list(losing.values()), axis=0) for against, losing in runs.losing.items()}
    pairs["most"] = -np.max(list(numbers.values()), axis=0)
    lost = []
    for label, row in pairs[counted & (pairs["most"] < 0)].sort_values(["most", "rank", "pair"]).iterrows():
        place = int(str(label))
        against = max(numbers, key=lambda name: numbers[name][place])
        cases = [
            runs.case(LOST, row, place, estimator, against)
            for estimator, losing in runs.losing[against].items()
            if losing[place]
        ]
        lost.append(min(cases, key=lambda c: (c.estimator != params.estimator, c.succeeded[1] - c.succeeded[0])))
    return rescued[: params.rescued] + lost[: params.lost]


class _Runs:
    """Shares of successful runs of every pair, in the order of the pairs, and who changes sides."""

    def __init__(self, photographs: Photographs, success_px: float, seeds: Sequence[int]) -> None:
        self._seeds, self._errors = tuple(seeds), error_runs(photographs)
        self._status = photographs.results.set_index(["pair", "estimator", "input", "seed"])["status"].to_dict()
        self._without = {estimator: photographs.inputs(estimator)[0] for estimator in photographs.estimators}
        self._share = {
            (estimator, name): (self._errors.of(estimator, name) < success_px).mean(axis=1)
            for estimator in photographs.estimators
            for name in photographs.inputs(estimator)
        }
        self.losing = {against: self._changing(LOST, against) for against in (WITHOUT_STEP, SNN)}
        self._rescued = self._changing(RESCUED, WITHOUT_STEP)

    def _inputs(self, estimator: str, against: str) -> tuple[str, str]:
        return (self._without[estimator] if against == WITHOUT_STEP else against, OURS)

    def _changing(self, kind: str, against: str) -> dict[str, BoolArray]:
        """Return, for each estimator that gets the other input, which pairs it rescues or loses."""
        changing = {}
        for estimator in self._without:
            other, ours = (self._share.get((estimator, name)) for name in self._inputs(estimator, against))
            if other is not None and ours is not None:
                fails, works = (other, ours) if kind == RESCUED else (ours, other)
                changing[estimator] = (fails < 0.5) & (works > 0.5)
        return changing

    def case(self, kind: str, row: pd.Series[Any], place: int, estimator: str, against: str) -> Case:
        """Return one pair as one estimator sees it."""
        first, second = inputs = self._inputs(estimator, against)
        changing = self._rescued if kind == RESCUED else self.losing[against]
        seeds = [self._median_seed(self._errors.of(estimator, name)[place]) for name in inputs]
        verdicts = [
            str(self._status[row["pair"], estimator, name, seed]) for name, seed in zip(inputs, seeds, strict=True)
        ]
        return Case(
            kind=kind,
            set_name=str(row["set"]),
            pair_id=str(row["pair_id"]),
            split=str(row["split"]),
            right_share=float(row["right_share"]),
            estimator=estimator,
            inputs=inputs,
            changed=sum(bool(members[place]) for members in changing.values()),
            of=len(changing),
            succeeded=(float(self._share[estimator, first][place]), float(self._share[estimator, second][place])),
            seeds=(seeds[0], seeds[1]),
            verdicts=(verdicts[0], verdicts[1]),
        )

    def _median_seed(self, errors: FloatArray) -> int:
        return self._seeds[int(np.argsort(errors, kind="stable")[(len(errors) - 1) // 2])]


def draw_cases(
    cases: Sequence[Case],
    pairs: Mapping[tuple[str, str], Pair],
    *,
    hand_overs: HandOvers,
    photographs: Path,
    frames: Path,
) -> None:
    """Draw every case, on photographs (``.jpg``) and on blank frames (``.png``): ``<name>-<input>``.

    Parameters
    ----------
    cases : sequence of Case
        As from `choose_cases`.
    pairs : mapping of (set, pair id) to Pair
        Where the photographs are.
    hand_overs : mapping
        As in the evaluation.
    photographs, frames : Path
        Folders, made if absent; that of the photographs must not be passed on.
    """
    for folder in (photographs, frames):
        folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        pair = pairs[case.set_name, case.pair_id]
        sets = match_pair(pair, case.inputs)
        blanks = tuple(np.full((height, width, 3), _BLANK, np.uint8) for width, height in pair.sizes())
        for name, seed in zip(case.inputs, case.seeds, strict=True):
            how = hand_overs[case.estimator][name]
            estimate = run_estimator(sets, pair, estimator=case.estimator, name=name, seed=seed, how=how)
            used = next((s for s in sets.sets[name] if s.roll_deg == estimate.roll_deg), sets.sets[name][0])
            _draw((pair.image1, pair.image2), used, estimate, photographs / f"{case.name}-{name}.jpg")
            _draw((blanks[0], blanks[1]), used, estimate, frames / f"{case.name}-{name}.png")


def _draw(images: tuple[Image, Image], matches: MatchSet, estimate: FundamentalEstimate, path: Path) -> None:
    write_picture(path, draw_matches(*images, matches, estimate, settings=_SETTINGS))
