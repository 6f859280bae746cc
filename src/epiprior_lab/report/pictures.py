"""Pictures that show images: the contact sheet of rendered pairs, one rescued pair, densities of the roll, the gallery.

The gallery shows the hardest rescued and the lost pairs: best matches and epipolar lines in both images, before and
after. Photographs may not be passed on. So every picture of it exists twice: on the photographs, in a folder that stays
here, and on blank frames of the same size, for the page that is committed.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from epiprior.draw.captions import draw_label
from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture
from epiprior.features.images import read_image
from epiprior.matching.baselines import standard_matches
from epiprior.matching.pair import orientation_differences, roll_density
from epiprior.rank import rank_matches
from epiprior.two_view import estimate_fundamental
from epiprior.types import FloatArray, IntArray, Status
from epiprior_lab.evaluation.inputs import match_pair
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.runs import estimates
from epiprior_lab.pairsets import DatasetError, Pair
from epiprior_lab.report.page import Block, Page, Picture, say
from epiprior_lab.report.results import PAIR, Results
from epiprior_lab.report.style import INK, MUTED, styled
from epiprior_lab.report.tables import SNN
from epiprior_lab.report.text import ALL, BASELINES, OURS, input_title, share
from epiprior_lab.scenes.render import encode_jpeg
from epiprior_lab.scenes.world import Image

EXAMPLE_ESTIMATOR = "usac"
ROLL_PANELS = 6
RESCUED, LOST = "rescued", "lost"
Side = dict[str, FloatArray]  # by input, ours last: shares of successful runs of an estimator, of every pair
_THUMBNAIL = (384, 288)
_GAP = 8
_PANEL_INCHES = (3.6, 1.78)
_ROLL = re.compile(r"roll=(-?\d+)deg")
_BLANK = 235


def contact_sheet(pair_sets: Mapping[str, Sequence[Pair]], path: Path) -> Path:
    """Draw pairs by family in rows of a figure, with what makes them easy or hard below each, and return `path`.

    A DatasetError says that there is no pair to show, an ImageError that an image cannot be read.
    """
    across = min(max((len(pairs) for pairs in pair_sets.values()), default=0), 4)
    if not across:
        raise DatasetError(f"{path}: no pairs for a contact sheet")
    places = [  # families begin a row each
        (family if k == 0 else " ", pairs[k] if k < len(pairs) else None)
        for family, pairs in pair_sets.items()
        for k in range(-(-len(pairs) // across) * across)
    ]
    rows = len(places) // across
    with styled(path, rows, across, (_PANEL_INCHES[0] * across, _PANEL_INCHES[1] * rows)) as (figure, axes):
        for cell, (title, pair) in zip(chain(*axes), places, strict=True):
            cell.set_axis_off()
            if pair is not None:
                left, right = _padded(_thumbnail(pair.image1), (0, 0, 0, _GAP)), _thumbnail(pair.image2)
                cell.imshow(np.hstack([left, right]), interpolation="none")
                cell.set_title(title, fontsize=11, color=INK)
                how: Any = {"ha": "center", "va": "top", "fontsize": 8, "color": MUTED}
                cell.text(0.5, -0.03, _caption(pair), transform=cell.transAxes, **how)
        engine = figure.get_layout_engine()
        if engine is not None:  # little room between panels
            engine.set(w_pad=0.04, h_pad=0.05, wspace=0.01, hspace=0.02)  # type: ignore[call-arg]
    return path


def _thumbnail(path: Path) -> Image:
    """Return an image at the size of the sheet, RGB, padded with white to its shape."""
    image = read_image(path, cv2.IMREAD_COLOR)
    width, height = _THUMBNAIL
    scale = min(width / image.shape[1], height / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:height, :width]
    high, wide = height - small.shape[0], width - small.shape[1]
    return _padded(cv2.cvtColor(small, cv2.COLOR_BGR2RGB), (high // 2, -(-high // 2), wide // 2, -(-wide // 2)))


def _padded(picture: np.ndarray[Any, Any], margins: tuple[int, int, int, int]) -> Image:
    """Return a picture with white on top, below, on the left and on the right, pixels."""
    return np.asarray(cv2.copyMakeBorder(picture, *margins, cv2.BORDER_CONSTANT, value=(255, 255, 255)), np.uint8)


def _caption(pair: Pair) -> str:
    """Return what makes a pair easy or hard, for a reader; a roll from -179 to 180 degrees."""
    turned = _ROLL.sub(lambda found: f"roll={(int(found[1]) + 179) % 360 - 179}deg", pair.difficulty)
    parts = [part.replace("=", " ").replace("deg", "°") for part in turned.split(";") if part]
    return "   ".join(parts) or pair.pair_id


def rescued_pair(results: Results, group: str, success_px: float) -> str:
    """Return the pair of a group that gained most: the largest difference of successes, then the smallest error."""
    before, after = (results.errors[EXAMPLE_ESTIMATOR, name] for name in (BASELINES[0], OURS))
    gain = (after < success_px).mean(axis=1) - (before < success_px).mean(axis=1)
    places = np.flatnonzero(results.masks[group])
    pair_ids = results.tables.pairs["pair_id"].to_numpy(str)
    order = np.lexsort((pair_ids[places], after.mean(axis=1)[places], -gain[places]))
    return str(pair_ids[places[order[0]]])


def example_picture(pair: Pair, path: Path) -> Path:
    """Draw the best matches and epipolar lines of a pair, the baseline on the left, ours on the right."""
    images = (pair.image1, pair.image2)
    before = estimate_fundamental(*images, estimator=EXAMPLE_ESTIMATOR, mode="standard")
    ranked = rank_matches(*images)
    after = estimate_fundamental(*images, estimator=EXAMPLE_ESTIMATOR, ranked=ranked)
    used = next((found for found in ranked.sets if found.roll_deg == after.roll_deg), ranked.sets[0])
    pictures = []
    for matches, found in ((standard_matches(*images), before), (used, after)):
        picture = draw_matches(*images, matches, found, settings=DrawSettings(max_matches=60, max_panel_size=640))
        if not found:
            why = draw_label(picture.shape[1], f"no epipolar lines: {found.message}")
            picture = np.vstack([picture, why])
        pictures.append(picture)
    height = max(len(picture) for picture in pictures)
    sides = [_padded(p, (0, height - len(p), 0, gap)) for p, gap in zip(pictures, (12, 0), strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_jpeg(np.hstack(sides), 88))
    return path


def rolled_pairs(results: Results, panels: int = ROLL_PANELS) -> dict[tuple[str, str], float]:
    """Return some pairs and their true roll, degrees: from half a turn down to slight ones, by (group, pair id)."""
    pairs = results.tables.pairs.dropna(subset="true_roll_deg")
    turn = pairs["true_roll_deg"].abs().round(6).sort_values(ascending=False, kind="stable")
    step = max(1, len(turn[turn > 20]) // panels)
    chosen = pairs.loc[turn.index[: step * panels : step]]
    return {(str(row["group"]), str(row["pair_id"])): float(row["true_roll_deg"]) for row in chosen.to_dict("records")}


def density_of_roll(pair: Pair, step: int = 2) -> tuple[FloatArray, FloatArray]:
    """Return angles, degrees, and the density of the roll over X_L and X_B, 1/degree (paper, section 4.2)."""
    matches = rank_matches(pair.image1, pair.image2).sets[0]
    chosen = (matches.distance_ratio < 1) | (matches.similarity_weight > 0)
    angles, density = roll_density(orientation_differences(matches.orientation1_deg, matches.orientation2_deg)[chosen])
    return angles[::step], density[::step]


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
    """Return so many pairs at most for the gallery, of those that count in the total.

    Rescued: most runs of the estimator fail without preprocessing and succeed with it, and the run that is drawn with
    it has the status `ok`; those with the fewest right matches in X_L first. Lost: the reverse, by as many estimators
    as possible, against the input without preprocessing or against `SNN`, whichever more of them lose against; drawn
    is the given estimator where it is among them, otherwise the one that loses most runs.
    """
    pairs = results.tables.pairs[results.masks[ALL]]
    status = results.tables.runs.set_index([*PAIR, "estimator", "input", "seed"])["status"].to_dict()
    order = pairs.assign(rank=pairs["right_share"].fillna(1.0)).sort_values(["rank", *PAIR], kind="stable")
    places: list[int] = order.index.tolist()
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
    settings = DrawSettings(max_matches=60, max_panel_size=560)
    for folder in (photographs, frames):
        folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        pair = pairs[case.group, case.pair_id]
        blanks = [np.full((height, width, 3), _BLANK, np.uint8) for width, height in pair.sizes()]
        matches, how = match_pair(pair, case.inputs), protocol.hand_overs[case.estimator]
        for name, seed in zip(case.inputs, case.seeds, strict=True):
            sets = matches.sets[name]
            one = replace(matches, sets={name: sets})
            ((*_, found),) = estimates(one, pair.pair_id, estimator=case.estimator, seeds=(seed,), hand_overs=how)
            used = next((matched for matched in sets if matched.roll_deg == found.roll_deg), sets[0])
            for folder, suffix, images in ((photographs, "jpg", (pair.image1, pair.image2)), (frames, "png", blanks)):
                picture = draw_matches(images[0], images[1], used, found, settings=settings)
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
    sections = {"Pairs": case_blocks(cases, ".", "jpg")}
    Page(title="Rescued and lost pairs", about=say("kept gallery"), sections=sections).write(folder, markdown="")
