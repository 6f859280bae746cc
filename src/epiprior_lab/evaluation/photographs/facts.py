"""What is found of a pair before any estimator runs: labels, how hard it is, its rankings, their calibration.

This module imports no estimator, so that a changed estimator leaves stored results as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from epiprior.types import BoolArray, MatchSet
from epiprior_lab.evaluation.photographs.truth import Truth, pair_truth, split_of
from epiprior_lab.evaluation.rankings import calibration_rows, curve_rows, ranking_rows
from epiprior_lab.features.matching import PRESETS, MatchFiles
from epiprior_lab.labels.ground_truth import LabelSettings, label_matches
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import TruthParams

Row = dict[str, Any]
LOWE = "standard"  # X_L by distance ratio: Lowe's order
UNRANKED = frozenset({"generalized"})  # candidates of low probability are no ranking
_TOP = 100


@dataclass(frozen=True, kw_only=True)
class PairFacts:
    """What is found before any estimator runs.

    Parameters
    ----------
    truth : Truth
        What estimates are measured against.
    pair : dict
        ``labels, points, split, standard_matches, right_share`` (of X_L; NaN without labels).
    rankings, ranking_curves, calibration : list of dict
        As in the study, with the input as ``ranking``; empty without labels.
    """

    truth: Truth
    pair: Row
    rankings: list[Row]
    ranking_curves: list[Row]
    calibration: list[Row]


def pair_facts(*, pair: Pair, matches: MatchFiles, truth: TruthParams) -> PairFacts:
    """Label the matches of a pair and measure their rankings.

    Parameters
    ----------
    pair : Pair
        Photographs with ground truth.
    matches : MatchFiles
        All inputs, ``standard`` (X_L) among them.
    truth : TruthParams
        When a match counts as right, and what makes a pair hard.

    Notes
    -----
    A ranking is the one-to-one list of an input, of the roll hypothesis whose first hundred are the most probable.
    Calibration is measured over all ranked matches of that of the expected roll.
    """
    sets = matches.read()
    known = pair_truth(pair, plane_px=truth.plane_px, one_plane=truth.one_plane)
    share = float("nan")
    rankings, curves, calibration = [], [], []
    if known.labels != "none":

        def right(matches: MatchSet) -> BoolArray:
            points = matches.x1, matches.x2, matches.scale1, matches.scale2
            return label_matches(pair, *points, settings=LabelSettings.of(truth))

        of_standard = right(sets.sets[LOWE][0])
        share = float(of_standard.mean()) if len(of_standard) else 0.0
        lists = {name: right(best_hypothesis(sets.sets[name])) for name in sets.sets if name not in UNRANKED}
        rankings, curves = ranking_rows(lists), curve_rows(lists)
        for preset in (name for name in sets.sets if name in PRESETS):
            ranked = sets.sets[preset][0]
            calibration += [{"preset": preset, **row} for row in calibration_rows(ranked, right(ranked))]
    split = split_of(share, easy=truth.easy_share, hard=truth.hard_share)
    found: Row = {"labels": known.labels, "points": known.points, "split": split}
    found |= {"standard_matches": len(sets.sets[LOWE][0]), "right_share": share}
    return PairFacts(truth=known, pair=found, rankings=rankings, ranking_curves=curves, calibration=calibration)


def best_hypothesis(sets: tuple[MatchSet, ...]) -> MatchSet:
    """Return the one-to-one list of the roll hypothesis whose first hundred are the most probable."""
    return max((found.one_to_one() for found in sets), key=lambda found: float(np.nansum(found.probability[:_TOP])))
