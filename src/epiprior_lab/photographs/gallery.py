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

from epiprior.draw import DrawSettings, draw_matches, write_picture
from epiprior.features import Image
from epiprior.types import FundamentalEstimate, MatchSet
from epiprior_lab.datasets import Pair
from epiprior_lab.evaluation import HandOvers
from epiprior_lab.matching import match_pair
from epiprior_lab.photographs.estimation import run_estimator
from epiprior_lab.photographs.params import GalleryParams
from epiprior_lab.photographs.results import OURS, Photographs, error_runs

RESCUED, LOST = "rescued", "lost"
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
    inputs : tuple of str
        Without preprocessing, and ours.
    succeeded : tuple of float
        Shares of the runs, of both inputs.
    seeds : tuple of int
        Run with the median error, of both inputs: what is drawn.
    """

    kind: str
    set_name: str
    pair_id: str
    split: str
    right_share: float
    inputs: tuple[str, str]
    succeeded: tuple[float, float]
    seeds: tuple[int, int]

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
        Rescued: most runs fail without preprocessing and succeed with it; those with the fewest right matches in X_L
        first. Lost: the reverse; those that lose most runs first. Only pairs that count in the total.
    """
    names = photographs.inputs(params.estimator)
    inputs = (names[0], OURS)
    runs = error_runs(photographs)
    errors = [runs.of(params.estimator, name) for name in inputs]
    table = photographs.pairs[["set", "pair_id", "pair", "split", "right_share"]].copy()
    for k in (0, 1):
        table[f"share{k}"] = (errors[k] < success_px).mean(axis=1)
        table[f"seed{k}"] = [seeds[int(np.argsort(row, kind="stable")[(len(row) - 1) // 2])] for row in errors[k]]
    table = table[table["pair"].isin(photographs.counted)]
    table["gain"] = table["share1"] - table["share0"]
    table["rank"] = table["right_share"].fillna(1.0)
    won = table[(table["share0"] < 0.5) & (table["share1"] > 0.5)].sort_values(["rank", "pair"]).head(params.rescued)
    lost = table[(table["share0"] > 0.5) & (table["share1"] < 0.5)].sort_values(["gain", "pair"]).head(params.lost)
    return [_case(kind, row, inputs) for kind, part in ((RESCUED, won), (LOST, lost)) for _, row in part.iterrows()]


def _case(kind: str, row: pd.Series[Any], inputs: tuple[str, str]) -> Case:
    return Case(
        kind=kind,
        set_name=str(row["set"]),
        pair_id=str(row["pair_id"]),
        split=str(row["split"]),
        right_share=float(row["right_share"]),
        inputs=inputs,
        succeeded=(float(row["share0"]), float(row["share1"])),
        seeds=(int(row["seed0"]), int(row["seed1"])),
    )


def draw_cases(
    cases: Sequence[Case],
    pairs: Mapping[tuple[str, str], Pair],
    *,
    estimator: str,
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
    estimator : str
        Whose runs are drawn.
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
            how = hand_overs[estimator][name]
            estimate = run_estimator(sets, pair, estimator=estimator, name=name, seed=seed, how=how)
            used = next((s for s in sets.sets[name] if s.roll_deg == estimate.roll_deg), sets.sets[name][0])
            _draw((pair.image1, pair.image2), used, estimate, photographs / f"{case.name}-{name}.jpg")
            _draw((blanks[0], blanks[1]), used, estimate, frames / f"{case.name}-{name}.png")


def _draw(images: tuple[Image, Image], matches: MatchSet, estimate: FundamentalEstimate, path: Path) -> None:
    write_picture(path, draw_matches(*images, matches, estimate, settings=_SETTINGS))
