"""Variants of the method, composed of its own steps (paper, "Analysis").

Everything before the votes is computed once per pair and preset; the variants differ in what they do with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from epiprior.features.images import View
from epiprior.matching.pair import PreparedPair, prepare_pair, roll_hypotheses
from epiprior.presets import DEFAULT, PreprocessSettings
from epiprior.rank import rank_voted
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.hypothesis import Candidates, UnitedMatches, Votes, cast_votes, find_candidates
from epiprior.ranking.models import RankingModel
from epiprior.ranking.probabilities import Union, two_keypoint_scores
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from epiprior.ranking.votes import count_votes, frame_points, rough_fundamental_matrices
from epiprior.types import Features, FloatArray, MatchSet
from epiprior_lab.evaluation.rankings import ranking_orders

Voter = Callable[[MatchFrames, TwoKeypointMatches, FloatArray, PreprocessSettings], Votes]


@dataclass(frozen=True)
class Proposals:
    """What precedes the votes, for one pair and one preset.

    `candidates` (X, matches of 2keypoints) and their `probabilities` have one item for each roll hypothesis.
    """

    prepared: PreparedPair
    candidates: tuple[Candidates, ...]
    probabilities: tuple[FloatArray, ...]
    settings: PreprocessSettings
    model: RankingModel


def propose(
    images: tuple[View, View], features: tuple[Features, Features], settings: PreprocessSettings, model: RankingModel
) -> Proposals:
    """Run the method up to the probabilities of the matches of 2keypoints (sections 4.1 to 4.4)."""
    prepared = prepare_pair(*images, settings, features1=features[0], features2=features[1])
    candidates = tuple(find_candidates(prepared, roll, settings) for roll in roll_hypotheses(prepared, settings))
    columns = model.two_keypoint.columns
    probabilities = tuple(model.two_keypoint(one.two_keypoints.select(columns)) for one in candidates)
    return Proposals(prepared, candidates, probabilities, settings, model)


def ranked_sets(
    proposals: Proposals,
    settings: PreprocessSettings | None = None,
    voter: Voter = cast_votes,
    *,
    standard: bool = True,
) -> tuple[MatchSet, ...]:
    """Vote and rank (sections 4.5 and 4.6), one set for each roll hypothesis.

    `settings` of the votes replace the preset's. Without `standard`, X is not united with X_L and X_B; its matches then
    miss d_r and t_k as the paper says. The model is the same, trained on the united matches; so are the matches of
    2keypoints, whose coherence depends on X_L and X_B as well.
    """
    return tuple(
        rank_voted(
            proposals.prepared,
            found if standard else _x_alone(found),
            voter(found.frames, found.two_keypoints, probability, settings or proposals.settings),
            proposals.model,
            settings or proposals.settings,
        )
        for found, probability in zip(proposals.candidates, proposals.probabilities, strict=True)
    )


def _x_alone(found: Candidates) -> Candidates:
    """Return the candidates without X_L and X_B."""
    union = found.united.union
    rows = union.in_x >= 0
    alone = Union(union.location1[rows], union.location2[rows], union.in_x[rows], np.full(len(found.X), -1))
    return replace(found, united=UnitedMatches(union=alone, frames=found.frames))


def oriented_votes(
    frames: MatchFrames, pairs: TwoKeypointMatches, probability: FloatArray, settings: PreprocessSettings = DEFAULT
) -> Votes:
    """Make a rough F of every two oriented matches instead of every two matches of 2keypoints.

    A match stands for itself and three points around it by scale and orientation of its features, so that two of them
    give eight points, as in BEEM (as we recall it); two matches of 2keypoints give sixteen. As many matches are taken,
    those with the best matches of 2keypoints. Parameters as for `epiprior.ranking.hypothesis.cast_votes`.
    """
    best, _ = two_keypoint_scores(pairs, probability, len(frames))
    order = np.lexsort((np.arange(len(best)), -best))
    rows = order[best[order] > 0][: settings.two_keypoint_count]
    y1, y2 = frame_points(frames, rows, rows, frame="feature", radius=settings.frame_radius)
    F = rough_fundamental_matrices(y1[:, :4], y2[:, :4])
    i, j = np.triu_indices(len(rows), 1)
    strengths = best[rows]
    sfm, weighted = count_votes(F, frames.x1, frames.x2, settings.vote_threshold, strengths[i] * strengths[j])
    return Votes(matrices=F, strengths=strengths, sfm=sfm, weighted=weighted, probability=probability)


def reordered(matches: MatchSet, ranking: str) -> MatchSet:
    """Return the matches in the order of one measure alone, its values instead of probabilities.

    `ranking` is ``2keypoint``, by the best match of 2keypoints, or ``sfm``, whose share of the matrices stands for the
    probability; matches without a positive value are left out. ``final``: the set as it is.
    """
    if ranking == "final":
        return matches
    taken = matches.take(ranking_orders(matches)[ranking])
    if ranking == "2keypoint":
        return replace(taken, probability=taken.two_keypoint_probability)
    return replace(taken, probability=taken.supporting_matrices / max(len(taken.rough_matrices), 1))
