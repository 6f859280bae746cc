"""Steps 3b to 7 under one roll hypothesis: clusters, X, 2keypoints, votes, kpmd (paper, sections 4.2 to 4.6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from epiprior.features.describe import describe_at_orientation
from epiprior.matching.clusters import Clusters, cluster_features
from epiprior.matching.pair import PreparedPair, both_images, unit_descriptors
from epiprior.matching.putative import PutativeMatches, putative_matches
from epiprior.presets import DEFAULT, PreprocessSettings
from epiprior.ranking.coherence import coherence, descriptor_weights
from epiprior.ranking.frames import MatchFrames, match_frames
from epiprior.ranking.probabilities import (
    MatchTable,
    StandardTable,
    Union,
    lookup,
    match_table,
    pair_columns,
    two_keypoint_scores,
    unite,
)
from epiprior.ranking.two_keypoints import (
    TwoKeypointMatches,
    best_two_keypoint_matches,
    describe_two_keypoint_matches,
    match_two_keypoints,
    neighbourhoods,
)
from epiprior.ranking.votes import count_votes, frame_points, rough_fundamental_matrices
from epiprior.stopwatch import Stopwatch
from epiprior.types import Float32Array, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class UnitedMatches:
    """X, X_L and X_B of one roll hypothesis together (section 4.6).

    Parameters
    ----------
    union : Union
        M matches of locations.
    frames : MatchFrames
        Of each match.
    """

    union: Union
    frames: MatchFrames

    def frames_of_x(self) -> MatchFrames:
        """Return the frames of the rows of X; the union keeps their order."""
        return self.frames.take(self.union.in_x >= 0)


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """What one roll hypothesis proposes.

    Parameters
    ----------
    roll_deg : float
        The hypothesis.
    X : PutativeMatches
        Putative matches of locations.
    frames : MatchFrames
        Of the rows of X.
    two_keypoints : TwoKeypointMatches
        With their descriptors 2kpmd.
    united : UnitedMatches
        X, X_L and X_B together.
    """

    roll_deg: float
    X: PutativeMatches
    frames: MatchFrames
    two_keypoints: TwoKeypointMatches
    united: UnitedMatches


@dataclass(frozen=True, kw_only=True)
class Votes:
    """The rough fundamental matrices of one roll hypothesis and what they say of each row of X.

    Parameters
    ----------
    matrices : ndarray, shape (P, 3, 3), float64
        Working pixels.
    chosen : ndarray, shape (K,), int64
        The 2keypoint matches they come from, best first.
    strengths : ndarray, shape (K,), float64
        How probable these are, descending.
    sfm : ndarray, shape (len(X),), int64
        Number of supported matrices.
    weighted : ndarray, shape (len(X),), float64
        The same, each matrix weighted by the product of the probabilities of its two 2keypoint matches.
    probability : ndarray, shape (T,), float64
        Of all 2keypoint matches.
    """

    matrices: FloatArray
    chosen: IntArray
    strengths: FloatArray
    sfm: IntArray
    weighted: FloatArray
    probability: FloatArray = field(repr=False)


def find_candidates(
    prepared: PreparedPair,
    roll_deg: float,
    settings: PreprocessSettings = DEFAULT,
    watch: Stopwatch | None = None,
) -> Candidates:
    """Cluster the features, match clusters, match 2keypoints (sections 4.2 to 4.4), under one roll hypothesis."""
    watch = watch or Stopwatch()

    def describe(k: int) -> Float32Array:
        features, photograph, first = (
            prepared.features[k],
            prepared.photographs[k],
            prepared.locations[k].first,
        )
        if photograph is None:
            return prepared.descriptors[k][first]
        raw = describe_at_orientation(photograph, features.take(first), roll_deg if k else 0.0)
        return unit_descriptors(raw, settings.features)

    def cluster(k: int) -> Clusters:
        return cluster_features(fixed[k], settings.min_cluster_similarity)

    with watch.step("fixed orientation"):
        fixed = both_images(describe)
    with watch.step("clusters"):
        clusters1, clusters2 = both_images(cluster)
    with watch.step("putative matches"):
        X = putative_matches(clusters1, clusters2, *fixed, settings.max_matches_per_cluster_pair)
        united = _unite(prepared, X, fixed, roll_deg)
        frames = united.frames_of_x()
    with watch.step("coherence"):
        around = _descriptor_coherence(united, prepared.table) if settings.extended else None
    with watch.step("2keypoints"):
        labels = (clusters1.label, clusters2.label)
        two_keypoints = _two_keypoints(prepared, X, frames, labels, around, settings)
    return Candidates(roll_deg=roll_deg, X=X, frames=frames, two_keypoints=two_keypoints, united=united)


def _unite(
    prepared: PreparedPair, X: PutativeMatches, fixed: tuple[Float32Array, Float32Array], roll_deg: float
) -> UnitedMatches:
    union = unite(X, prepared.table)
    frames = match_frames(
        union.location1,
        union.location2,
        prepared.locations,
        prepared.orientation_rad,
        prepared.descriptors,
        fixed,
        float(np.deg2rad(roll_deg)),
    )
    return UnitedMatches(union=union, frames=frames)


def _descriptor_coherence(united: UnitedMatches, table: StandardTable) -> FloatArray:
    """Return the coherence of each row of X, its neighbours weighted by what their descriptors say."""
    union = united.union
    weights = descriptor_weights(union.location1, union.location2, united.frames.fixed_similarity, union.ratios(table))
    return coherence(united.frames, union.location1, weights)[union.in_x >= 0]


def _two_keypoints(
    prepared: PreparedPair,
    X: PutativeMatches,
    frames: MatchFrames,
    labels: tuple[IntArray, IntArray],
    around: FloatArray | None,
    settings: PreprocessSettings,
) -> TwoKeypointMatches:
    neighbours = [
        neighbourhoods(
            place.xy,
            place.scale,
            label,
            nearest=settings.nearest,
            within=settings.within,
            nearest_of_cluster=settings.nearest_of_cluster,
            max_within=settings.max_within,
        )
        for place, label in zip(prepared.locations, labels, strict=True)
    ]
    main, other = match_two_keypoints(X, *neighbours)
    same = labels[0][X.feature1[main]] == labels[0][X.feature1[other]]
    same &= labels[1][X.feature2[main]] == labels[1][X.feature2[other]]
    return describe_two_keypoint_matches(X, frames, main, other, same, around)


def cast_votes(
    frames: MatchFrames,
    pairs: TwoKeypointMatches,
    probability: FloatArray,
    settings: PreprocessSettings = DEFAULT,
) -> Votes:
    """Choose the best 2keypoint matches, make a rough F of every two, count their votes (sections 4.4 and 4.5).

    Parameters
    ----------
    frames : MatchFrames
        Of the rows of X.
    pairs : TwoKeypointMatches
        T matches of 2keypoints.
    probability : ndarray, shape (T,), float64
        That each 2keypoint match is right.
    settings : PreprocessSettings
        The preset.
    """
    chosen = best_two_keypoint_matches(pairs, probability, settings.two_keypoint_count)
    y1, y2 = frame_points(
        frames, pairs.main[chosen], pairs.other[chosen], frame=settings.frame, radius=settings.frame_radius
    )
    F = rough_fundamental_matrices(y1, y2)
    i, j = np.triu_indices(len(chosen), 1)
    strengths = probability[chosen]
    weights = strengths[i] * strengths[j]
    sfm, weighted = count_votes(F, frames.x1, frames.x2, settings.vote_threshold, weights)
    return Votes(matrices=F, chosen=chosen, strengths=strengths, sfm=sfm, weighted=weighted, probability=probability)


def describe_matches(
    united: UnitedMatches, table: StandardTable, two_keypoints: TwoKeypointMatches, votes: Votes
) -> MatchTable:
    """Describe every match by kpmd (section 4.6)."""
    frames, union = united.frames, united.union
    scores = two_keypoint_scores(two_keypoints, votes.probability, len(votes.sfm))
    around = coherence(frames, union.location1, lookup(scores[0], union.in_x, 0.0))
    pair = pair_columns(votes.strengths, votes.weighted)
    return match_table(union, frames, table, votes.sfm, votes.weighted, scores, around, pair)
