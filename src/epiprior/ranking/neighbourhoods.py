"""Step 5a: the neighbours of a feature, with which it makes 2keypoints (paper, section 4.4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epiprior.kernels.compilation import compiled
from epiprior.presets import DEFAULT, PreprocessSettings
from epiprior.types import FloatArray, IntArray

NEAREST, WITHIN, SAME_CLUSTER = 1, 2, 4


@dataclass(frozen=True)
class Neighbourhoods:
    """The neighbours of every feature of one image, and by which of the paper's three methods each is one."""

    start: IntArray  # (N + 1,), neighbours of feature i are the entries start[i]:start[i + 1]
    neighbour: IntArray  # (E,), ascending within each neighbourhood; never at the same location
    rule: NDArray[np.uint8]  # (E,), a sum of NEAREST, WITHIN and SAME_CLUSTER


def nearest_points(points: FloatArray, queries: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """Return distances and indices of the `count` nearest points of each query, shape (Q, min(count, P)).

    Ties, to 1e-9, are broken by index, so that the order does not depend on the tree.
    """
    k = min(count, len(points))
    found = cKDTree(points).query(queries, k=k, workers=-1)
    distance, index = (np.ascontiguousarray(each.reshape(len(queries), k)) for each in found)
    index = index.astype(np.int64, copy=False)
    _order_ties(distance, index)
    return distance, index


@compiled
def _order_ties(distance, index):  # type: ignore[no-untyped-def]
    """Sort rows that are sorted but for ties by rounded distance, then by index, in place."""
    for row in range(len(distance)):
        for q in range(1, distance.shape[1]):
            d, n = distance[row, q], index[row, q]
            key, k = np.rint(d * 1e9), q
            while k > 0:
                before = np.rint(distance[row, k - 1] * 1e9)
                if before < key or (before == key and index[row, k - 1] < n):
                    break
                distance[row, k], index[row, k] = distance[row, k - 1], index[row, k - 1]
                k -= 1
            distance[row, k], index[row, k] = d, n


def neighbourhoods(
    xy: FloatArray, scale: FloatArray, label: IntArray, settings: PreprocessSettings = DEFAULT
) -> Neighbourhoods:
    """Find the neighbours of every feature by the paper's three methods; `scale` is sigma, in the unit of `xy`.

    The `nearest` (K_1) features; all features `within` so many sigma (K_2), but at most the nearest `max_within`; the
    `nearest_of_cluster` (K_3) features of the same cluster. The paper has no limit of K_2; large features need one.
    """
    n = len(xy)
    if n < 2:
        return Neighbourhoods(np.zeros(n + 1, np.int64), np.empty(0, np.int64), np.empty(0, np.uint8))
    # Some of the nearest may lie at the very same place and do not count: a 2keypoint has a length.
    nearest, max_within = settings.nearest, settings.max_within
    distance, index = nearest_points(xy, xy, max(nearest, max_within) + 4)
    members = np.argsort(label, kind="stable")
    cluster_start = np.searchsorted(label[members], np.arange(label.max() + 2))
    limits = (nearest, settings.within, max_within, settings.nearest_of_cluster)
    return Neighbourhoods(*_collect(index, distance, xy, scale, label, members, cluster_start, *limits))


@compiled
def _nearest_members(i, xy, group, nearest, distance):  # type: ignore[no-untyped-def]
    """Fill `nearest` with the nearest members of a cluster to feature i, and return how many there are."""
    found = 0
    for j in group:
        d = np.hypot(xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1])
        if d <= 1e-6 or (found == len(nearest) and d >= distance[found - 1]):
            continue
        found = min(found + 1, len(nearest))
        q = found - 1  # few: inserted in order
        while q > 0 and distance[q - 1] > d:
            nearest[q], distance[q] = nearest[q - 1], distance[q - 1]
            q -= 1
        nearest[q], distance[q] = j, d
    return found


@compiled
def _put_in_order(neighbour, rule, first, end):  # type: ignore[no-untyped-def]
    for q in range(first + 1, end):
        j, flags, k = neighbour[q], rule[q], q
        while k > first and neighbour[k - 1] > j:
            neighbour[k], rule[k] = neighbour[k - 1], rule[k - 1]
            k -= 1
        neighbour[k], rule[k] = j, flags


@compiled
def _collect(index, distance, xy, scale, label, members, cluster_start, k1, k2, max_within, k3):  # type: ignore[no-untyped-def]
    n = len(xy)
    capacity = index.shape[1] + k3
    start = np.zeros(n + 1, np.int64)
    neighbour = np.empty(n * capacity, np.int64)
    rule = np.empty(n * capacity, np.uint8)
    nearest, distance_of = np.empty(k3, np.int64), np.empty(k3)
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
        if len(group) > 1 and k3 > 0:
            for q in range(_nearest_members(i, xy, group, nearest, distance_of)):
                j, known = nearest[q], False
                for e in range(first, end):
                    if neighbour[e] == j:
                        rule[e] |= SAME_CLUSTER
                        known = True
                if not known:
                    neighbour[end], rule[end] = j, SAME_CLUSTER
                    end += 1
        _put_in_order(neighbour, rule, first, end)
        start[i + 1] = end
    return start, neighbour[:end].copy(), rule[:end].copy()
