"""Rankings of the matches of one pair against the ground truth: precision, roll densities, calibration.

The rankings are those of the paper's figure of cumulative precision and of its analysis: ``lowe`` (X_L by
distance ratio), ``blogs`` (X_B by similarity weight), ``2keypoint`` (by the best 2keypoint match that holds
the match), ``sfm`` (by supporting fundamental matrices) and ``final`` (by probability).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from epiprior.matching.roll import expected_roll, orientation_differences, roll_density
from epiprior.types import BoolArray, IntArray, MatchSet
from epiprior_lab.evaluation.statistics import (
    RANKING_DEPTHS,
    average_precision,
    calibration_bins,
    log_ranks,
    precision_at,
    right_among_first,
)
from epiprior_lab.labels.ground_truth import LabelSettings, label_matches
from epiprior_lab.pairsets import Pair

Row = dict[str, Any]

RANKINGS = ("lowe", "blogs", "2keypoint", "sfm", "final")
_MAX_RANK = 10_000
_ROLL_STEP = 4  # of the density's half degrees


def ranking_orders(matches: MatchSet) -> dict[str, IntArray]:
    """Return the indices of the matches that take part in each ranking, best first.

    Parameters
    ----------
    matches : MatchSet
        A ranked set: X, X_L and X_B together, sorted by probability.

    Returns
    -------
    dict of str to ndarray, shape (n,), int64
        For each of `RANKINGS`. Ties are broken by the features' indices, so that no ranking profits from
        another.
    """

    def order(score: np.ndarray[Any, Any], member: BoolArray) -> IntArray:
        index = np.flatnonzero(member)
        return np.asarray(index[np.lexsort((matches.feature2[index], matches.feature1[index], -score[index]))])

    return {
        "lowe": order(-matches.distance_ratio, matches.distance_ratio < 1),
        "blogs": order(matches.similarity_weight, matches.similarity_weight > 0),
        "2keypoint": order(matches.two_keypoint_probability, matches.two_keypoint_probability > 0),
        "sfm": order(matches.supporting_matrices, matches.supporting_matrices > 0),
        "final": np.arange(len(matches)),
    }


def ranked_lists(pair: Pair, matches: MatchSet, labels: LabelSettings) -> dict[str, BoolArray]:
    """Return which matches of each ranking are right, best first.

    Parameters
    ----------
    pair : Pair
        Gives the ground truth.
    matches : MatchSet
        A ranked set.
    labels : LabelSettings
        When a match counts as right.

    Returns
    -------
    dict of str to ndarray, shape (n,), bool
        For each of `RANKINGS`.
    """
    right = label_matches(pair, matches.x1, matches.x2, matches.scale1, matches.scale2, settings=labels)
    return {name: right[index] for name, index in ranking_orders(matches).items()}


def ranking_rows(lists: dict[str, BoolArray]) -> list[Row]:
    """Return one row per ranking: its size, right matches, precision at several depths, average precision."""
    return [
        {
            "ranking": name,
            "matches": len(right),
            "right": int(np.count_nonzero(right)),
            **{f"precision_{depth}": precision_at(right, depth) for depth in RANKING_DEPTHS},
            "average_precision": average_precision(right),
        }
        for name, right in lists.items()
    ]


def curve_rows(lists: dict[str, BoolArray]) -> list[Row]:
    """Return one row per ranking and rank: ``ranking, rank, right`` among the first `rank` matches."""
    ranks = log_ranks(_MAX_RANK, per_decade=10)
    return [
        {"ranking": name, "rank": int(rank), "right": int(hits)}
        for name, right in lists.items()
        for rank, hits in zip(ranks, right_among_first(right, ranks), strict=True)
    ]


def calibration_rows(matches: MatchSet, right: BoolArray, bins: int = 20) -> list[Row]:
    """Return one row per bin of probability: ``bin, count, right, probability, squared_error``.

    Parameters
    ----------
    matches : MatchSet
        A ranked set.
    right : ndarray, shape (N,), bool
        Whether each of its matches is right.
    bins : int
        Number of bins; sums of pairs may be added.
    """
    sums = calibration_bins(matches.probability, right, bins)
    return [
        {
            "bin": b,
            "count": int(sums.count[b]),
            "right": int(sums.right[b]),
            "probability": float(sums.probability[b]),
            "squared_error": float(sums.squared_error[b]),
        }
        for b in range(bins)
    ]


def true_roll_deg(pair: Pair) -> float:
    """Return the roll between the cameras, degrees in (-180, 180]; NaN without cameras.

    Notes
    -----
    The angle of the rotation that lies closest to the upper left 2 x 2 block of the relative rotation: how
    directions near the optical axis turn in the image, clockwise as seen on the screen.
    """
    if pair.camera1 is None or pair.camera2 is None:
        return float("nan")
    R = pair.camera2.R @ pair.camera1.R.T
    return float(np.degrees(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])))


def roll_rows(pair: Pair, matches: MatchSet) -> list[Row]:
    """Return the density of the roll over X_L and X_B, every two degrees (paper, section 4.2).

    Returns
    -------
    list of dict
        ``true_roll_deg`` (from the cameras), ``expected_roll_deg`` (the highest peak), ``angle_deg`` in [0,
        360) and ``density`` per degree.
    """
    standard = (matches.distance_ratio < 1) | (matches.similarity_weight > 0)
    differences = orientation_differences(matches.orientation1_deg, matches.orientation2_deg)[standard]
    angles, density = roll_density(differences)
    row = {"true_roll_deg": true_roll_deg(pair), "expected_roll_deg": expected_roll(differences)}
    return [
        {**row, "angle_deg": float(a), "density": float(d)}
        for a, d in zip(angles[::_ROLL_STEP], density[::_ROLL_STEP], strict=True)
    ]
