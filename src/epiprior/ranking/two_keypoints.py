"""Step 5b: matches of pairs of close features (2keypoints) and their descriptor 2kpmd (paper, section 4.4)."""

from dataclasses import dataclass

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.matching.putative import PutativeMatches
from epiprior.presets import PAPER_TWO_KEYPOINT_COLUMNS, TWO_KEYPOINT_COLUMNS
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.neighbourhoods import Neighbourhoods
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True)
class TwoKeypointMatches:
    """Matches of 2keypoints: two putative matches whose features are close in both images (section 4.4)."""

    main: IntArray  # (T,), row in X of the match of the main points (p1, p2)
    other: IntArray  # (T,), row in X of the match of their neighbours (n1, n2)
    columns: tuple[str, ...]
    descriptors: Float32Array  # (T, C), 2kpmd: lengths in sigma of the main point, angles in radians

    def __len__(self) -> int:
        return len(self.main)

    def select(self, columns: tuple[str, ...]) -> Float32Array:
        """Return the named columns, in that order."""
        return np.ascontiguousarray(self.descriptors[:, [self.columns.index(name) for name in columns]])


@compiled
def _match_pairs(feature1, feature2, row_start, start1, neighbour1, rule1, start2, neighbour2, rule2, main, other):  # type: ignore[no-untyped-def]
    """Return the number of matches of 2keypoints; write as many as the outputs have room for."""
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
    """Find all matches of 2keypoints, each once however many of the three methods give it, as rows of X, shape (T,).

    Both (p1, p2) and (n1, n2) must be in X, and n1, n2 must be neighbours of p1, p2 by the same method. A pair and its
    swap are two of them; their descriptors differ.
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
    """Compute the descriptor 2kpmd of each match of 2keypoints, `main` and `other` from `match_two_keypoints`.

    `same_cluster`, shape (T,), says whether p and n belong to one cluster in both images. If `around`, shape (len(X),
    4), from `coherence`, is given, the columns are added that the paper does not have: how far the changes of scale and
    orientation of both matches disagree, the similarities, the numbers of candidates, how far the turns are from the
    roll hypothesis, and this coherence of both matches.
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
    names = PAPER_TWO_KEYPOINT_COLUMNS if around is None else TWO_KEYPOINT_COLUMNS
    return TwoKeypointMatches(main, other, names, np.column_stack(columns).astype(np.float32))


def _occurrences(p: IntArray, n: IntArray) -> FloatArray:
    """Return how often each ordered pair of features occurs: N1 or N2."""
    out = np.empty(len(p))
    _count_pairs(p, n, int(p.max(initial=-1)) + 1, np.zeros(int(n.max(initial=-1)) + 1, np.int64), out)
    return out


@compiled
def _count_pairs(p, n, features, counts, out):  # type: ignore[no-untyped-def]
    """Write how often each pair (p, n) occurs, feature by feature of p; `counts`, all zero, have room for every n."""
    start = np.zeros(features + 2, np.int64)
    for k in range(len(p)):
        start[p[k] + 2] += 1
    for feature in range(features):
        start[feature + 2] += start[feature + 1]
    order = np.empty(len(p), np.int64)
    for k in range(len(p)):
        order[start[p[k] + 1]] = k
        start[p[k] + 1] += 1
    for feature in range(features):
        group = order[start[feature] : start[feature + 1]]
        for k in group:
            counts[n[k]] += 1
        for k in group:
            out[k] = counts[n[k]]
        for k in group:
            counts[n[k]] = 0


def best_two_keypoint_matches(matches: TwoKeypointMatches, probability: FloatArray, count: int = 100) -> IntArray:
    """Return the `count` (K_2kp) most probable matches of 2keypoints, best first (section 4.4).

    A pair and its swap, the same four features, count once. A tree gives hundreds of them one probability: ties go to
    those that agree best in direction and length, ``angle_d / pi - dist_r``, then to the lower index. On training
    scenes, out-of-fold, 0.44 of the paper's first two are right, against 0.35 with the fewer N1 + N2 first.
    """
    ratio, angle = (matches.descriptors[:, matches.columns.index(n)] for n in ("distance_ratio", "angle_difference"))
    room = 4 * count
    while True:
        rows = np.arange(len(matches))
        if room < len(rows):  # the head of the ranking nearly always has enough that differ
            rows = np.flatnonzero(probability >= np.partition(probability, -room)[-room])
        rows = rows[np.lexsort((rows, angle[rows] / np.pi - ratio[rows], -probability[rows]))]
        main, other = matches.main[rows], matches.other[rows]
        key = np.minimum(main, other) * (int(max(main.max(initial=0), other.max(initial=0))) + 1)
        _, first = np.unique(key + np.maximum(main, other), return_index=True)
        if len(first) >= count or len(rows) == len(matches):
            return rows[np.sort(first)[:count]]
        room *= 8
