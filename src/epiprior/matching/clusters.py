"""Step 3b: clusters of similar features within one image (paper, section 4.2).

Average linkage on one minus the similarity, cut at a similarity of 0.85; the paper says "agglomerative" and leaves the
linkage open. The average linkage of two groups is below the cut only if that of some pair across is, so clusters never
leave a connected component of the graph {similarity >= 0.85}: components are found by blocks, linkage runs within each.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.types import Float32Array, IntArray

_BLOCK, _STRIP = 256, 32


@dataclass(frozen=True)
class Clusters:
    """A partition of the features of one image."""

    label: IntArray  # (N,), cluster of each feature; clusters are numbered by their first member
    members: IntArray  # (N,), features, cluster by cluster, ascending within each
    start: IntArray  # (C + 1,), cluster c holds members[start[c]:start[c + 1]]
    representative: Float32Array  # (C, D), median descriptor of the members, normalised again

    def __len__(self) -> int:
        return len(self.start) - 1


@compiled
def _root(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def _join_similar(S, row0, threshold, parent):  # type: ignore[no-untyped-def]
    """Join features whose similarity in this block (rows and columns from `row0`) reaches the threshold."""
    count = S.shape[1]
    for r in range(S.shape[0]):
        for first in range(r + 1, count, _STRIP):
            last = min(first + _STRIP, count)
            similar = np.int32(0)
            for c in range(first, last):
                similar += np.int32(S[r, c] >= threshold)
            if similar == 0:
                continue
            for c in range(first, last):
                if S[r, c] >= threshold:
                    a, b = _root(parent, row0 + r), _root(parent, row0 + c)
                    parent[max(a, b)] = min(a, b)


@compiled
def _all_roots(parent):  # type: ignore[no-untyped-def]
    for i in range(len(parent)):
        parent[i] = _root(parent, i)


@compiled
def _nearest_alive(D, alive, a, previous):  # type: ignore[no-untyped-def]
    """Return the nearest cluster to `a`; the previous link of the chain wins a tie, then the lower index."""
    best, nearest = np.float32(np.inf), -1
    if previous >= 0:
        best, nearest = D[a, previous], previous
    for k in range(len(alive)):
        if alive[k] and k != a and D[a, k] < best:
            best, nearest = D[a, k], k
    return best, nearest


@compiled
def _average_linkage(D, cut):  # type: ignore[no-untyped-def]
    """Return the cluster (lowest member) of each row of the distance matrix `D`, which is overwritten.

    Nearest-neighbour chain. A mutual pair of nearest neighbours beyond the cut never merges, and neither does either of
    it with anything else, since average linkage is reducible: both are finished.
    """
    m = D.shape[0]
    owner = np.arange(m)
    size = np.ones(m, np.int64)
    alive = np.ones(m, np.bool_)
    chain = np.empty(m, np.int64)
    length = 0
    first = 0
    while True:
        if length == 0:
            while first < m and not alive[first]:
                first += 1
            if first == m:
                break
            chain[0] = first
            length = 1
        a = chain[length - 1]
        previous = chain[length - 2] if length > 1 else -1
        d, b = _nearest_alive(D, alive, a, previous)
        if b < 0:
            alive[a] = False
            length = 0
        elif b != previous:
            chain[length] = b
            length += 1
        elif d > cut:
            alive[a] = False
            alive[b] = False
            length -= 2
        else:
            keep, gone = min(a, b), max(a, b)
            for k in range(m):
                if alive[k] and k not in (keep, gone):
                    mean = (size[keep] * D[keep, k] + size[gone] * D[gone, k]) / (size[keep] + size[gone])
                    D[keep, k] = mean
                    D[k, keep] = mean
            size[keep] += size[gone]
            alive[gone] = False
            owner[gone] = keep
            length -= 2
    for i in range(m):
        owner[i] = owner[owner[i]]
    return owner


@compiled
def _median_descriptors(descriptors, members, start):  # type: ignore[no-untyped-def]
    out = np.empty((len(start) - 1, descriptors.shape[1]), np.float32)
    for c in range(len(start) - 1):
        n = start[c + 1] - start[c]
        if n == 1:
            for j in range(descriptors.shape[1]):
                out[c, j] = descriptors[members[start[c]], j]
            continue
        column = np.empty(n, np.float32)
        for j in range(descriptors.shape[1]):
            for k in range(n):
                v = descriptors[members[start[c] + k], j]
                q = k  # few members: inserted in order
                while q > 0 and column[q - 1] > v:
                    column[q] = column[q - 1]
                    q -= 1
                column[q] = v
            out[c, j] = (column[(n - 1) // 2] + column[n // 2]) / np.float32(2)
    return out


def cluster_features(descriptors: Float32Array, min_similarity: float = 0.85) -> Clusters:
    """Cluster the features of one image by their unit descriptors at a fixed orientation, shape (N, D), float32.

    Merging stops below the average similarity `min_similarity`, in (-1, 1). Every feature is in exactly one cluster.
    """
    n = len(descriptors)
    owner = np.arange(n)
    memory = np.empty(_BLOCK * n, np.float32)  # one for all blocks: fresh memory costs as much as the products
    for row0 in range(0, n, _BLOCK):
        rows = descriptors[row0 : row0 + _BLOCK]
        S = np.matmul(rows, descriptors[row0:].T, out=memory[: len(rows) * (n - row0)].reshape(len(rows), -1))
        _join_similar(S, row0, np.float32(min_similarity), owner)
    _all_roots(owner)
    order = np.argsort(owner, kind="stable")
    bounds = np.flatnonzero(np.diff(owner[order], prepend=-1, append=n))
    for lo, hi in pairwise(bounds.tolist()):
        if hi - lo > 1:
            component = order[lo:hi]
            d = descriptors[component]
            owner[component] = component[_average_linkage(1 - d @ d.T, np.float32(1 - min_similarity))]
    _, label = np.unique(owner, return_inverse=True)
    members = np.argsort(label, kind="stable")
    start = np.searchsorted(label[members], np.arange(label.max(initial=-1) + 2))
    medians = _median_descriptors(descriptors, members, start)
    medians /= np.maximum(np.linalg.norm(medians, axis=1, keepdims=True), np.float32(1e-12))
    return Clusters(label.astype(np.int64), members.astype(np.int64), start.astype(np.int64), medians)
