"""What is found of a pair before any estimator runs: its truth, its rankings, the calibration of its probabilities.

The rankings are those of the paper's figure of cumulative precision and of its analysis: ``lowe`` (X_L by distance
ratio), ``blogs`` (X_B by similarity weight), ``2keypoint`` (by the best 2keypoint match that holds the match), ``sfm``
(by supporting fundamental matrices) and ``final`` (by probability). This module imports no estimator, so that a changed
estimator leaves stored results as they are.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.matching.pair import expected_roll, orientation_differences
from epiprior.types import BoolArray, IntArray, MatchSet
from epiprior_lab.evaluation.inputs import PRESETS, read_matches
from epiprior_lab.evaluation.records import RANKS, CalibrationRecord, PairRecord, RankingRecord, Record
from epiprior_lab.evaluation.truth import pair_truth, true_roll_deg
from epiprior_lab.labels.ground_truth import label_matches
from epiprior_lab.measures import average_precision, calibration_bins
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import TruthParams

_TOP = 100


def ranking_orders(matches: MatchSet) -> dict[str, IntArray]:
    """Return the indices of the matches that take part in each ranking, best first.

    `matches` are X, X_L and X_B together, sorted by probability. Ties are broken by the features' indices.
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


def best_hypothesis(sets: Sequence[MatchSet]) -> MatchSet:
    """Return the set of the roll hypothesis whose 100 most probable one-to-one matches are the most probable."""
    return max(sets, key=lambda found: float(np.nansum(found.one_to_one().probability[:_TOP])))


def walked(matches: MatchSet, order: IntArray) -> IntArray:
    """Return the indices of `order` without those of matches whose feature, in either image, was used before."""
    return np.asarray(order[one_to_one_mask(matches.feature1[order], matches.feature2[order])])


def pair_records(*, pair: Pair, matches: Mapping[str, Path], group: str, truth: TruthParams) -> list[Record]:
    """Return the records of a pair, its rankings and their calibration; the last two only for a labelled pair.

    `matches` are the files of all inputs; without ``standard`` the difficulty stays unknown.
    """
    read, known = read_matches(matches), pair_truth(pair, truth)
    sets = read.sets
    key: dict[str, Any] = {"group": group, "pair_id": pair.pair_id, "scene": pair.scene}
    share = float("nan")
    records: list[Record] = []
    for name in sets if known.labels else ():
        ranked = best_hypothesis(sets[name])
        scales = (np.nan_to_num(scale) for scale in (ranked.scale1, ranked.scale2))  # a peer's may be unknown
        right = label_matches(pair, ranked.x1, ranked.x2, *scales, settings=truth)
        if name == "standard":
            share = float(right.mean()) if len(right) else 0.0
        orders = ranking_orders(ranked) if name in PRESETS else {"final": np.arange(len(ranked))}
        features1, features2 = read.features[name]
        for ranking, order in orders.items():
            hits = right[walked(ranked, order)]
            records.append(
                RankingRecord(
                    **key,
                    input=name,
                    ranking=ranking,
                    features1=features1,
                    features2=features2,
                    matches=len(hits),
                    right=int(np.count_nonzero(hits)),
                    average_precision=average_precision(hits),
                    right_at=tuple(int(np.count_nonzero(hits[:rank])) for rank in RANKS),
                )
            )
        if name in PRESETS:
            sums = vars(calibration_bins(ranked.probability, right))
            for k in range(len(sums["count"])):
                own = {column: values[k].item() for column, values in sums.items()}
                records.append(CalibrationRecord(**key, input=name, bin=k, **own))
    roll = float("nan")
    if "default" in sets and len(sets["default"][0]):  # read from the matches of X_L and X_B (section 4.2)
        ranked = sets["default"][0]
        standard = (ranked.distance_ratio < 1) | (ranked.similarity_weight > 0)
        roll = float(expected_roll(orientation_differences(ranked.orientation1_deg, ranked.orientation2_deg)[standard]))
    features1, features2 = next(iter(read.features.values()))
    about = PairRecord(
        **key,
        features1=features1,
        features2=features2,
        labels=known.labels,
        points=known.points,
        right_share=share,
        difficulty=truth.difficulty(share),
        true_roll_deg=true_roll_deg(pair),
        expected_roll_deg=roll,
    )
    return [about, *records]
