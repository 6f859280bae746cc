"""Steps 3b to 7 under one roll hypothesis: clusters, X, 2keypoints, votes, kpmd (paper, sections 4.2 to 4.6)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from epiprior.features.describe import describe_at_orientation, normalise_descriptors
from epiprior.kernels.parallel import in_threads
from epiprior.matching.clusters import Clusters, cluster_features
from epiprior.matching.pair import PreparedPair, Stopwatch
from epiprior.matching.putative import PutativeMatches, putative_matches
from epiprior.matching.standard import StandardTable
from epiprior.presets import DEFAULT, PreprocessSettings
from epiprior.ranking.coherence import coherence, descriptor_weights
from epiprior.ranking.frames import MatchFrames, match_frames
from epiprior.ranking.neighbourhoods import neighbourhoods
from epiprior.ranking.probabilities import MatchTable, Union, match_table, pair_columns, two_keypoint_scores, unite
from epiprior.ranking.two_keypoints import (
    TwoKeypointMatches,
    best_two_keypoint_matches,
    describe_two_keypoint_matches,
    match_two_keypoints,
)
from epiprior.ranking.votes import count_votes, frame_points, rough_fundamental_matrices
from epiprior.types import Float32Array, FloatArray, IntArray

# Unit descriptors of the locations of one image at a fixed orientation, (L, D), and their clusters.
ClusteredImage = tuple[Float32Array, Clusters]


@dataclass(frozen=True, kw_only=True)
class UnitedMatches:
    """X, X_L and X_B of one roll hypothesis together (section 4.6), and the frames of each match."""

    union: Union
    frames: MatchFrames

    def frames_of_x(self) -> MatchFrames:
        """Return the frames of the rows of X; the union keeps their order."""
        return self.frames.take(self.union.in_x >= 0)


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """What is known under one roll hypothesis before any classifier."""

    roll_deg: float  # the hypothesis
    X: PutativeMatches  # of locations
    frames: MatchFrames  # of the rows of X
    two_keypoints: TwoKeypointMatches  # with their descriptors 2kpmd
    united: UnitedMatches  # X, X_L and X_B together


@dataclass(frozen=True, kw_only=True)
class Votes:
    """The rough fundamental matrices of one roll hypothesis and their votes for each row of X."""

    matrices: FloatArray  # (P, 3, 3), working pixels
    strengths: FloatArray  # (K,), probabilities of the 2keypoint matches that the matrices come from, descending
    sfm: IntArray  # (len(X),), number of supported matrices
    weighted: FloatArray  # (len(X),), each matrix weighted by the probabilities of its two 2keypoint matches
    probability: FloatArray = field(repr=False)  # (T,), of all 2keypoint matches


def cluster_images(
    prepared: PreparedPair,
    rolls_deg: Sequence[float],
    settings: PreprocessSettings = DEFAULT,
    watch: Stopwatch | None = None,
) -> list[tuple[ClusteredImage, ClusteredImage]]:
    """Describe and cluster both images (section 4.2) under each roll hypothesis; all share what is done for image 1."""
    watch, how = watch or Stopwatch(), settings.features
    views = [(0, 0.0), *((1, roll_deg) for roll_deg in rolls_deg)]

    def describe(view: tuple[int, float]) -> Float32Array:
        k, orientation_deg = view
        photograph, first = prepared.photographs[k], prepared.locations[k].first
        if photograph is None:
            return prepared.descriptors[k][first]
        raw = describe_at_orientation(photograph, prepared.features[k].take(first), orientation_deg)
        return normalise_descriptors(raw, root=how.root, centred=how.centred)

    with watch.step("fixed orientation"):
        fixed = in_threads(describe, views)
    with watch.step("clusters"):
        clusters = in_threads(lambda one: cluster_features(one, settings.min_cluster_similarity), fixed)
    first, *second = zip(fixed, clusters, strict=True)
    return [(first, one) for one in second]


def find_candidates(
    prepared: PreparedPair,
    roll_deg: float,
    settings: PreprocessSettings = DEFAULT,
    watch: Stopwatch | None = None,
    *,
    clustered: tuple[ClusteredImage, ClusteredImage] | None = None,
) -> Candidates:
    """Cluster the features, match clusters, match 2keypoints (sections 4.2 to 4.4), under one roll hypothesis.

    `clustered` are both images of `cluster_images`, if that is done.
    """
    watch = watch or Stopwatch()
    one, two = clustered or cluster_images(prepared, [roll_deg], settings, watch)[0]
    fixed, (clusters1, clusters2) = (one[0], two[0]), (one[1], two[1])
    with watch.step("putative matches"):
        X = putative_matches(clusters1, clusters2, *fixed, settings.max_matches_per_cluster_pair)
        union = unite(X, prepared.table)
        all_frames = match_frames(prepared, union.location1, union.location2, fixed, roll_deg)
        united = UnitedMatches(union=union, frames=all_frames)
        frames = united.frames_of_x()
    with watch.step("coherence"):
        around = None
        if settings.extended:
            ratios = union.of_standard(prepared.table.distance_ratio, 1.0)
            weights = descriptor_weights(union.location1, union.location2, all_frames.fixed_similarity, ratios)
            around = coherence(all_frames, union.location1, weights)[union.in_x >= 0]
    with watch.step("2keypoints"):
        label1, label2 = clusters1.label, clusters2.label
        neighbours = (
            neighbourhoods(place.xy, place.scale, label, settings)
            for place, label in zip(prepared.locations, (label1, label2), strict=True)
        )
        main, other = match_two_keypoints(X, *neighbours)
        same_cluster = label1[X.feature1[main]] == label1[X.feature1[other]]
        same_cluster &= label2[X.feature2[main]] == label2[X.feature2[other]]
        two_keypoints = describe_two_keypoint_matches(X, frames, main, other, same_cluster, around)
    return Candidates(roll_deg=roll_deg, X=X, frames=frames, two_keypoints=two_keypoints, united=united)


def cast_votes(
    frames: MatchFrames, pairs: TwoKeypointMatches, probability: FloatArray, settings: PreprocessSettings = DEFAULT
) -> Votes:
    """Choose the best 2keypoint matches, make a rough F of every two, count their votes (sections 4.4 and 4.5).

    `frames` are those of the rows of X, `probability`, shape (T,), those of the T matches of 2keypoints.
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
    return Votes(matrices=F, strengths=strengths, sfm=sfm, weighted=weighted, probability=probability)


def describe_matches(
    united: UnitedMatches, table: StandardTable, two_keypoints: TwoKeypointMatches, votes: Votes
) -> MatchTable:
    """Describe every match by kpmd (section 4.6)."""
    frames, union = united.frames, united.union
    scores = two_keypoint_scores(two_keypoints, votes.probability, len(votes.sfm))
    around = coherence(frames, union.location1, union.of_x(scores[0]))
    pair = pair_columns(votes.strengths, votes.weighted)
    return match_table(union, frames, table, votes.sfm, votes.weighted, scores, around, pair)
