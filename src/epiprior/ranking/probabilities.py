"""Step 7: the union of X, X_L and X_B with the descriptor kpmd, from which probabilities come (paper, section 4.6)."""

from dataclasses import dataclass

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.matching.putative import PutativeMatches
from epiprior.matching.standard import StandardTable
from epiprior.presets import MATCH_COLUMNS
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from epiprior.types import Float32Array, FloatArray, IntArray


@dataclass(frozen=True)
class Union:
    """X, X_L and X_B together, ordered by location of image 1, then of image 2."""

    location1: IntArray  # (M,)
    location2: IntArray  # (M,)
    in_x: IntArray  # (M,), row in X, or -1
    in_standard: IntArray  # (M,), row in the standard table, or -1

    def __len__(self) -> int:
        return len(self.location1)

    def of_x(self, values: FloatArray) -> FloatArray:
        """Return for each match the value of its row of X; 0 outside X."""
        return _lookup(values, self.in_x, 0.0)

    def of_standard(self, values: FloatArray, missing: float) -> FloatArray:
        """Return for each match the value of its row of the standard table; `missing` where it has none."""
        return _lookup(values, self.in_standard, missing)


def unite(X: PutativeMatches, table: StandardTable) -> Union:
    """Return the union of X with the standard matches."""
    width = 1 + int(max(X.feature2.max(initial=0), table.location2.max(initial=0)))
    key_x = X.feature1 * width + X.feature2
    key_s = table.location1 * width + table.location2
    keys = np.union1d(key_x, key_s)
    in_x, in_standard = np.full(len(keys), -1, np.int64), np.full(len(keys), -1, np.int64)
    in_x[np.searchsorted(keys, key_x)] = np.arange(len(key_x))
    in_standard[np.searchsorted(keys, key_s)] = np.arange(len(key_s))
    return Union(keys // width, keys % width, in_x, in_standard)


def _lookup(values: FloatArray, rows: IntArray, missing: float) -> FloatArray:
    out = np.full(len(rows), missing)
    out[rows >= 0] = values[rows[rows >= 0]]
    return out


@compiled
def best_rival(score, feature):  # type: ignore[no-untyped-def]
    """Return for each match the highest score >= 0 among the other matches of its feature; 0 without any."""
    size = 0
    for f in feature:
        size = max(size, f + 1)
    best, second, holder = np.zeros(size), np.zeros(size), np.full(size, -1)
    for m in range(len(score)):
        f = feature[m]
        if holder[f] < 0 or score[m] > best[f]:
            second[f], best[f], holder[f] = best[f], score[m], m
        elif score[m] > second[f]:
            second[f] = score[m]
    rival = np.empty(len(score))
    for m in range(len(score)):
        f = feature[m]
        rival[m] = second[f] if holder[f] == m else best[f]
    return rival


def two_keypoint_scores(
    matches: TwoKeypointMatches, probability: FloatArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """Return the best and the summed probability of the 2keypoint matches that hold each row of X, shape (size,)."""
    best, total = np.zeros(size), np.zeros(size)
    for rows in (matches.main, matches.other):
        np.maximum.at(best, rows, probability)
        total += np.bincount(rows, weights=probability, minlength=size)
    return best, total


def pair_columns(strengths: FloatArray, weighted: FloatArray) -> tuple[float, float, float]:
    """Return measures of the pair as a whole, in [0, 1]: on a hard pair the same votes mean less.

    They are the mean of the ten highest strengths, the mean of all, and the highest share of the weighted votes that
    one match has; 0 where there is none. `strengths` descend: the probabilities of what the matrices were made of.
    """
    if not len(strengths):
        return 0.0, 0.0, 0.0
    total = (float(strengths.sum()) ** 2 - float((strengths**2).sum())) / 2
    share = float(weighted.max(initial=0.0)) / total if total > 0 else 0.0
    return float(strengths[:10].mean()), float(strengths.mean()), min(share, 1.0)


@dataclass(frozen=True)
class MatchTable:
    """The descriptor kpmd of every match of the union: named columns, float32, shape (M, C)."""

    columns: tuple[str, ...]
    descriptors: Float32Array

    def select(self, columns: tuple[str, ...]) -> Float32Array:
        """Return the named columns, in that order."""
        return np.ascontiguousarray(self.descriptors[:, [self.columns.index(name) for name in columns]])

    def column(self, name: str) -> FloatArray:
        """Return one column."""
        return self.descriptors[:, self.columns.index(name)].astype(np.float64)


def match_table(
    union: Union,
    frames: MatchFrames,
    table: StandardTable,
    sfm: IntArray,
    weighted: FloatArray,
    two_keypoint: tuple[FloatArray, FloatArray],
    around: FloatArray,
    pair: tuple[float, float, float],
) -> MatchTable:
    """Compute kpmd (section 4.6) of M matches: the paper's three columns, and ours.

    `sfm` and `weighted` are votes of the rows of X, `two_keypoint` is from `two_keypoint_scores`; matches outside X get
    0. A match that is not in `table` gets d_r = 1 and t_k = 0. `around`, shape (M, 4), is from `coherence`, `pair` from
    `pair_columns`, the same for every match.
    """
    votes, share = union.of_x(sfm.astype(np.float64)), union.of_x(weighted)
    rivals = np.bincount(union.location1)[union.location1] + np.bincount(union.location2)[union.location2] - 2
    rival = np.maximum(best_rival(share, union.location1), best_rival(share, union.location2))
    columns = [
        votes,
        union.of_standard(table.distance_ratio, 1.0),
        union.of_standard(table.similarity_weight, 0.0),
        union.of_standard(table.mutual.astype(np.float64), 0.0),
        union.of_standard(table.distance_ratio_backward, 1.0),
        frames.similarity,
        frames.fixed_similarity,
        *(union.of_x(scores) for scores in two_keypoint),
        votes / max(float(votes.max(initial=0)), 1.0),
        share / max(float(share.max(initial=0)), 1e-12),
        share / np.maximum(share + rival, 1e-12),
        rivals.astype(np.float64),
        frames.roll_error,
        np.abs(frames.scale_change),
        *around.T,
        *(np.full(len(union), value) for value in pair),
    ]
    return MatchTable(MATCH_COLUMNS, np.column_stack(columns).astype(np.float32))
