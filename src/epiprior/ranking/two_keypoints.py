"""Step 5: pairs of close features (2keypoints), their matches and the descriptor 2kpmd (paper, section 4.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epiprior.matching.putative import PutativeMatches
from epiprior.ranking.coherence import COLUMNS as COHERENCE_COLUMNS
from epiprior.ranking.frames import MatchFrames
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray

NEAREST, WITHIN, SAME_CLUSTER = 1, 2, 4

PAPER_COLUMNS = (
    "two_keypoint_matches1",
    "two_keypoint_matches2",
    "distance_ratio",
    "angle_difference",
    "same_cluster",
    "min_distance",
)
DEFAULT_COLUMNS = (
    *PAPER_COLUMNS,
    "scale_change_difference",
    "turn_difference",
    "similarity_main",
    "similarity_neighbour",
    "fixed_similarity_main",
    "fixed_similarity_neighbour",
    "candidates_main",
    "candidates_neighbour",
    "roll_error_main",
    "roll_error_neighbour",
    "scale_change_main",
    *(f"{name}_{match}" for match in ("main", "neighbour") for name in COHERENCE_COLUMNS),
)


@dataclass(frozen=True)
class Neighbourhoods:
    """The neighbours of every feature of one image.

    Parameters
    ----------
    start : ndarray, shape (N + 1,), int64
        Neighbours of feature i are the entries ``start[i]:start[i + 1]``.
    neighbour : ndarray, shape (E,), int64
        Feature, ascending within each neighbourhood; never at the same location.
    rule : ndarray, shape (E,), uint8
        By which of the paper's three methods: 1 nearest, 2 within a distance, 4 nearest of the same cluster, or a sum.
    """

    start: IntArray
    neighbour: IntArray
    rule: NDArray[np.uint8]


@dataclass(frozen=True)
class TwoKeypointMatches:
    """Matches of 2keypoints: two putative matches whose features are close in both images.

    Parameters
    ----------
    main, other : ndarray, shape (T,), int64
        Row in X of the match of the main points (p1, p2) and of their neighbours (n1, n2).
    columns : tuple of str
        Names of the columns of `descriptors`.
    descriptors : ndarray, shape (T, C), float32
        2kpmd: lengths in sigma of the main point, angles in radians.
    """

    main: IntArray
    other: IntArray
    columns: tuple[str, ...]
    descriptors: Float32Array

    def __len__(self) -> int:
        return len(self.main)

    def select(self, columns: tuple[str, ...]) -> Float32Array:
        """Return the named columns, in that order."""
        return np.ascontiguousarray(self.descriptors[:, [self.columns.index(name) for name in columns]])


def neighbourhoods(
    xy: FloatArray,
    scale: FloatArray,
    label: IntArray,
    *,
    nearest: int = 5,
    within: float = 5.0,
    nearest_of_cluster: int = 1,
    max_within: int = 40,
) -> Neighbourhoods:
    """Find the neighbours of every feature by the paper's three methods.

    Parameters
    ----------
    xy : ndarray, shape (N, 2), float64
        Locations.
    scale : ndarray, shape (N,), float64
        Sigma, in the same unit.
    label : ndarray, shape (N,), int64
        Cluster of each feature.
    nearest : int
        K_1: so many nearest features.
    within : float
        K_2: all features within this many sigma,
    max_within : int
        but at most so many, the nearest ones. The paper has no such limit; the largest features need one.
    nearest_of_cluster : int
        K_3: so many nearest features of the same cluster.
    """
    n = len(xy)
    if n < 2:
        return Neighbourhoods(np.zeros(n + 1, np.int64), np.empty(0, np.int64), np.empty(0, np.uint8))
    # Some of the nearest may lie at the very same place and do not count: a 2keypoint has a length.
    k = min(n, max(nearest, max_within) + 4)
    distance, index = cKDTree(xy).query(xy, k=k)
    distance, index = distance.reshape(n, -1), index.reshape(n, -1).astype(np.int64)
    # Ties by index, so that the order does not depend on the tree.
    order = np.lexsort((index, np.round(distance, 9)), axis=1)
    distance, index = np.take_along_axis(distance, order, 1), np.take_along_axis(index, order, 1)
    members = np.argsort(label, kind="stable")
    cluster_start = np.searchsorted(label[members], np.arange(label.max() + 2))
    start, neighbour, rule = _collect(
        index,
        distance,
        xy,
        scale,
        label,
        members,
        cluster_start,
        nearest,
        within,
        max_within,
        nearest_of_cluster,
    )
    return Neighbourhoods(start, neighbour, rule)


@numba.njit(cache=True, nogil=True)
def _nearest_members(i, xy, group, count):  # type: ignore[no-untyped-def]
    """Return the `count` nearest members of a cluster to feature i, fewer if it has no more."""
    distance = np.empty(len(group))
    for q in range(len(group)):
        d = np.hypot(xy[group[q], 0] - xy[i, 0], xy[group[q], 1] - xy[i, 1])
        distance[q] = d if d > 1e-6 else np.inf
    order = np.argsort(distance, kind="mergesort")
    found = 0
    while found < min(count, len(group)) and np.isfinite(distance[order[found]]):
        found += 1
    return group[order[:found]]


@numba.njit(cache=True, nogil=True)
def _collect(index, distance, xy, scale, label, members, cluster_start, k1, k2, max_within, k3):  # type: ignore[no-untyped-def]
    n = len(xy)
    capacity = index.shape[1] + k3
    start = np.zeros(n + 1, np.int64)
    neighbour = np.empty(n * capacity, np.int64)
    rule = np.empty(n * capacity, np.uint8)
    end = 0
    for i in range(n):
        first = end
        rank = 0
        for q in range(index.shape[1]):
            if distance[i, q] <= 1e-6:
                continue
            flag = NEAREST if rank < k1 else 0
            if distance[i, q] <= k2 * scale[i] and rank < max_within:
                flag |= WITHIN
            rank += 1
            if flag == 0:
                break
            neighbour[end], rule[end] = index[i, q], flag
            end += 1
        group = members[cluster_start[label[i]] : cluster_start[label[i] + 1]]
        if len(group) > 1:
            for j in _nearest_members(i, xy, group, k3):
                known = False
                for e in range(first, end):
                    if neighbour[e] == j:
                        rule[e] |= SAME_CLUSTER
                        known = True
                if not known:
                    neighbour[end], rule[end] = j, SAME_CLUSTER
                    end += 1
        order = np.argsort(neighbour[first:end], kind="mergesort")
        neighbour[first:end] = neighbour[first:end][order]
        rule[first:end] = rule[first:end][order]
        start[i + 1] = end
    return start, neighbour[:end].copy(), rule[:end].copy()


@numba.njit(cache=True, nogil=True)
def _match_pairs(feature1, feature2, row_start, start1, neighbour1, rule1, start2, neighbour2, rule2, main, other):  # type: ignore[no-untyped-def]
    """Count the matches of 2keypoints; write them when the outputs have room."""
    count = 0
    for m in range(len(feature1)):
        p1, p2 = feature1[m], feature2[m]
        lo2, hi2 = start2[p2], start2[p2 + 1]
        for e in range(start1[p1], start1[p1 + 1]):
            n1 = neighbour1[e]
            # Both lists ascend: walk down the candidates of n1 and the neighbours of p2 together.
            f = lo2
            for row in range(row_start[n1], row_start[n1 + 1]):
                n2 = feature2[row]
                while f < hi2 and neighbour2[f] < n2:
                    f += 1
                if f == hi2:
                    break
                if neighbour2[f] == n2 and rule1[e] & rule2[f]:
                    if count < len(main):
                        main[count] = m
                        other[count] = row
                    count += 1
    return count


def match_two_keypoints(
    X: PutativeMatches, neighbours1: Neighbourhoods, neighbours2: Neighbourhoods
) -> tuple[IntArray, IntArray]:
    """Find all matches of 2keypoints, each once however many of the three methods give it.

    Parameters
    ----------
    X : PutativeMatches
        Both (p1, p2) and (n1, n2) must be in it, and n1, n2 must be neighbours by the same method.
    neighbours1, neighbours2 : Neighbourhoods
        Of the features of both images.

    Returns
    -------
    main, other : ndarray, shape (T,), int64
        Rows of X. A pair and its swap are two of them; their descriptors differ.
    """
    around1 = (neighbours1.start, neighbours1.neighbour, neighbours1.rule)
    around2 = (neighbours2.start, neighbours2.neighbour, neighbours2.rule)
    main = other = np.empty(0, np.int64)
    total = _match_pairs(X.feature1, X.feature2, X.start1, *around1, *around2, main, other)
    main, other = np.empty(total, np.int64), np.empty(total, np.int64)
    _match_pairs(X.feature1, X.feature2, X.start1, *around1, *around2, main, other)
    return main, other


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return the size of an angle modulo a full turn, radians in [0, pi]."""
    return np.asarray(np.abs(np.angle(np.exp(1j * angle))))


def describe_two_keypoint_matches(
    X: PutativeMatches,
    frames: MatchFrames,
    main: IntArray,
    other: IntArray,
    same_cluster: BoolArray,
    around: FloatArray | None = None,
) -> TwoKeypointMatches:
    """Compute the descriptor 2kpmd of each match of 2keypoints.

    Parameters
    ----------
    X : PutativeMatches
        The putative matches.
    frames : MatchFrames
        Location, scale, orientation and similarities of each row of X.
    main, other : ndarray, shape (T,), int64
        From `match_two_keypoints`.
    same_cluster : ndarray, shape (T,), bool
        Whether p and n belong to one cluster (in both images).
    around : ndarray, shape (len(X), 4), float64, optional
        From `epiprior.ranking.coherence.coherence`. If given, the columns are added that the paper does not have:
        how far the
        changes of scale and orientation of both matches disagree, the similarities, the numbers of candidates, how far
        the turns are from the roll hypothesis, and this coherence of both matches.
    """
    f = frames
    vector1, vector2 = f.x1[other] - f.x1[main], f.x2[other] - f.x2[main]
    d1 = np.hypot(*vector1.T) / f.scale1[main]
    d2 = np.hypot(*vector2.T) / f.scale2[main]
    theta1 = np.arctan2(vector1[:, 1], vector1[:, 0]) - f.orientation1_rad[main]
    theta2 = np.arctan2(vector2[:, 1], vector2[:, 0]) - f.orientation2_rad[main]
    columns: list[FloatArray] = [
        _occurrences(X.feature1[main], X.feature1[other]),
        _occurrences(X.feature2[main], X.feature2[other]),
        np.minimum(d1 / d2, d2 / d1),
        _wrapped(theta1 - theta2),
        same_cluster.astype(np.float64),
        np.minimum(d1, d2),
    ]
    if around is not None:
        scale_change = f.scale_change
        turn = f.orientation2_rad - f.orientation1_rad
        candidates = (X.candidates1[X.feature1] * X.candidates2[X.feature2]).astype(np.float64)
        columns += [
            np.abs(scale_change[main] - scale_change[other]),
            _wrapped(turn[main] - turn[other]),
            *(column[rows] for column in (f.similarity, f.fixed_similarity) for rows in (main, other)),
            *(column[rows] for column in (candidates, f.roll_error) for rows in (main, other)),
            np.abs(scale_change[main]),
            *(column[rows] for rows in (main, other) for column in around.T),
        ]
    names = PAPER_COLUMNS if around is None else DEFAULT_COLUMNS
    return TwoKeypointMatches(main, other, names, np.column_stack(columns).astype(np.float32))


def _occurrences(p: IntArray, n: IntArray) -> FloatArray:
    """Return how often each ordered pair of features occurs: N1 or N2."""
    if not len(p):
        return np.empty(0)
    key = p * (int(n.max()) + 1) + n
    _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse.reshape(-1)], dtype=np.float64)


def best_two_keypoint_matches(matches: TwoKeypointMatches, probability: FloatArray, count: int = 100) -> IntArray:
    """Return the `count` most probable matches of 2keypoints, best first (section 4.4, K_2kp).

    Parameters
    ----------
    matches : TwoKeypointMatches
        All of them.
    probability : ndarray, shape (T,), float64
        From the classifier.
    count : int
        K_2kp. A pair and its swap, the same four features, count once.

    Returns
    -------
    ndarray, shape (at most count,), int64
        Ties go to the fewer N1 + N2, then to the lower index.
    """
    occurrences = matches.descriptors[:, 0] + matches.descriptors[:, 1]
    order = np.lexsort((np.arange(len(matches)), occurrences, -probability))
    low = np.minimum(matches.main, matches.other)[order]
    high = np.maximum(matches.main, matches.other)[order]
    _, first = np.unique(np.column_stack([low, high]), axis=0, return_index=True)
    return order[np.sort(first)[:count]]
