"""The hardest rescued and the lost pairs: best matches and epipolar lines in both images, before and after.

Photographs may not be passed on. So every picture exists twice: on the photographs, in a folder that stays here, and
on blank frames of the same size, for the page that is committed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture
from epiprior.types import FloatArray, IntArray, Status
from epiprior_lab.evaluation.inputs import match_pair
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.runs import estimates
from epiprior_lab.pairsets import Pair
from epiprior_lab.report.page import Block, Page, Picture, Section, say
from epiprior_lab.report.results import Results
from epiprior_lab.report.tables import SNN
from epiprior_lab.report.text import BASELINES, OURS, input_title, share

RESCUED, LOST = "rescued", "lost"
Side = dict[str, FloatArray]  # by input, ours last: shares of successful runs of an estimator, of every pair
_BLANK = 235
_SETTINGS = DrawSettings(max_matches=60, max_panel_size=560)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A pair that is shown: `RESCUED` or `LOST` by `changed` of so many estimators `of`.

    Of `estimator` and of both `inputs`, the second ours: shares of runs that succeeded, the seeds with the median
    error, which are drawn, and the statuses of these runs.
    """

    kind: str
    group: str
    pair_id: str
    difficulty: str
    right_share: float
    estimator: str
    inputs: tuple[str, str]
    changed: int
    of: int
    succeeded: tuple[float, float]
    seeds: tuple[int, int]
    statuses: tuple[str, str]

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.kind}-{self.group}-{self.pair_id}"


def choose_cases(results: Results, estimator: str, *, rescued: int, lost: int, success_px: float) -> list[Case]:
    """Return so many pairs to show at most, of those that count in the total.

    Rescued: most runs of the estimator fail without preprocessing and succeed with it, and the run that is drawn with
    it has the status `ok`; those with the fewest right matches in X_L first. Lost: the reverse, by as many estimators
    as possible, against the input without preprocessing or against `SNN`, whichever more of them lose against; drawn
    is the given estimator where it is among them, otherwise the one that loses most runs.
    """
    pairs, counted = results.tables.pairs, results.masks["all"]
    keys = ["group", "pair_id", "estimator", "input", "seed"]
    status = results.tables.runs.set_index(keys)["status"].to_dict()
    order = pairs.assign(rank=pairs["right_share"].fillna(1.0)).sort_values(["rank", "group", "pair_id"], kind="stable")
    places = [int(str(k)) for k in order.index if counted[int(str(k))]]
    sides = {against: _sides(results, against, success_px) for against in (BASELINES[0], SNN)}
    found = [_case(results, status, RESCUED, k, estimator, sides[BASELINES[0]]) for k in places]
    shown = [c for c in found if c.succeeded[0] < 0.5 < c.succeeded[1] and c.statuses[1] == Status.OK][:rescued]
    losing = {name: [_changing(LOST, side) for side in own.values()] for name, own in sides.items() if own}
    numbers = {name: np.sum(own, axis=0) for name, own in losing.items()}
    most = np.max(list(numbers.values()), axis=0)
    for k in sorted((k for k in places if most[k]), key=lambda k: -most[k])[:lost]:
        own = sides[max(numbers, key=lambda name: numbers[name][k])]
        cases = [_case(results, status, LOST, k, e, own) for e, side in own.items() if _changing(LOST, side)[k]]
        shown.append(min(cases, key=lambda c: (c.estimator != estimator, c.succeeded[1] - c.succeeded[0])))
    return shown


def _sides(results: Results, against: str, success_px: float) -> dict[str, Side]:
    """Return both inputs of each estimator that gets the other one, and the shares of its runs that succeed."""
    names = {e: results.inputs(e)[0] if against == BASELINES[0] else against for e in results.estimators}
    return {
        e: {name: results.errors.of(e, name, success_px) for name in (other, OURS)}
        for e, other in names.items()
        if {other, OURS} <= set(results.inputs(e))
    }


def _changing(kind: str, side: Side) -> IntArray:
    """Return which pairs an estimator rescues or loses, as 0 and 1."""
    other, ours = side.values()
    fails, works = (other, ours) if kind == RESCUED else (ours, other)
    return ((fails < 0.5) & (works > 0.5)).astype(np.int64)


def _case(
    results: Results, status: Mapping[Any, str], kind: str, place: int, estimator: str, sides: Mapping[str, Side]
) -> Case:
    """Return one pair as one estimator sees it; `status` is by the keys of a run."""
    pair, inputs = results.tables.pairs.iloc[place], tuple(sides[estimator])
    known = sorted(results.tables.runs["seed"].unique())
    errors = [results.errors[estimator, name][place] for name in inputs]
    seeds = [int(known[np.argsort(e, kind="stable")[(len(e) - 1) // 2]]) for e in errors]
    key = (pair["group"], pair["pair_id"], estimator)
    own: dict[str, Any] = {name: str(pair[name]) for name in ("group", "pair_id", "difficulty")}
    own |= {"inputs": inputs, "seeds": tuple(seeds), "right_share": float(pair["right_share"])}
    own["statuses"] = tuple(str(status[(*key, name, seed)]) for name, seed in zip(inputs, seeds, strict=True))
    own["succeeded"] = tuple(float(share[place]) for share in sides[estimator].values())
    changed = sum(int(_changing(kind, side)[place]) for side in sides.values())
    return Case(kind=kind, estimator=estimator, changed=changed, of=len(sides), **own)


def draw_cases(
    cases: Sequence[Case], pairs: Mapping[tuple[str, str], Pair], protocol: Protocol, *, photographs: Path, frames: Path
) -> None:
    """Draw every case of `pairs`, by (group, pair id), into two folders: ``<name>-<input>``.

    On photographs (``.jpg``), in a folder that must not be passed on, and on blank frames (``.png``).
    """
    for folder in (photographs, frames):
        folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        pair = pairs[case.group, case.pair_id]
        blanks = [np.full((height, width, 3), _BLANK, np.uint8) for width, height in pair.sizes()]
        matches = match_pair(pair, case.inputs)
        for name, seed in zip(case.inputs, case.seeds, strict=True):
            sets = matches.sets[name]
            one, how = replace(matches, sets={name: sets}), protocol.hand_overs[case.estimator]
            ((*_, found),) = estimates(one, pair.pair_id, estimator=case.estimator, seeds=(seed,), hand_overs=how)
            used = next((matched for matched in sets if matched.roll_deg == found.roll_deg), sets[0])
            on_both = (photographs, "jpg", (pair.image1, pair.image2)), (frames, "png", blanks)
            for folder, suffix, images in on_both:
                picture = draw_matches(images[0], images[1], used, found, settings=_SETTINGS)
                write_picture(folder / f"{case.name}-{name}.{suffix}", picture)


def case_blocks(cases: Sequence[Case], folder: str, suffix: str) -> list[Block]:
    """Return what a page shows of each case; its pictures are in `folder` beside the page."""
    blocks: list[Block] = []
    for case in cases:
        right = share(case.right_share) or "unknown"
        against = "the input without preprocessing" if case.inputs[0] in BASELINES else input_title(case.inputs[0])
        verb = "rescue" if case.kind == RESCUED else "lose"
        about = f"{case.changed} of {case.of} estimators {verb} it against {against}"
        level = case.difficulty or "unlabelled"
        blocks.append(f"**{case.kind}**: {case.group}, `{case.pair_id}` ({level}, right in X_L: {right}). {about}.")
        pictures = []
        for name, succeeded, status in zip(case.inputs, case.succeeded, case.statuses, strict=True):
            title = input_title(name)
            caption = f"{title}: {share(succeeded)} of the runs of {case.estimator} succeed; drawn: `{status}`"
            alt = f"{case.pair_id}, {title}: best matches and epipolar lines"
            pictures.append(Picture(path=f"{folder}/{case.name}-{name}.{suffix}", alt=alt, caption=caption))
        blocks.append(tuple(pictures))
    return blocks


def write_gallery(cases: Sequence[Case], folder: Path) -> None:
    """Write the page of the pictures on photographs, beside them; it may not be passed on."""
    section = Section(title="Pairs", blocks=case_blocks(cases, ".", "jpg"))
    Page(title="Rescued and lost pairs", about=say("kept gallery"), sections=[section]).write(folder, markdown="")
