"""Step 4: the putative matches X, from clusters matched in both directions (paper, section 4.3)."""

import logging
from dataclasses import dataclass

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.kernels.descriptor import inner_product
from epiprior.matching.clusters import Clusters
from epiprior.matching.standard import nearest_neighbours
from epiprior.types import Float32Array, IntArray

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PutativeMatches:
    """The set X, ordered by feature of image 1, then of image 2; features are numbered by location."""

    feature1: IntArray  # (M,)
    feature2: IntArray  # (M,)
    start1: IntArray  # (N1 + 1,), matches of feature i of image 1 are the rows start1[i]:start1[i + 1]
    candidates1: IntArray  # (N1,), in how many matches each feature of image 1 takes part
    candidates2: IntArray  # (N2,), the same for image 2

    def __len__(self) -> int:
        return len(self.feature1)


def matched_clusters(clusters1: Clusters, clusters2: Clusters) -> IntArray:
    """Match each cluster to the closest of the other image, in both directions: distinct pairs, (P, 2), ascending."""
    if not len(clusters1) or not len(clusters2):
        return np.empty((0, 2), np.int64)
    forward, backward = nearest_neighbours(clusters1.representative, clusters2.representative)
    there = np.column_stack([np.arange(len(clusters1)), forward.nearest])
    back = np.column_stack([backward.nearest, np.arange(len(clusters2))])
    return np.unique(np.concatenate([there, back]), axis=0)


@compiled
def _member_pairs(pairs, members1, start1, members2, start2, d1, d2, limit):  # type: ignore[no-untyped-def]
    """List all pairs of members of matched clusters; above the limit, the most similar ones."""
    total = 0
    for k in range(len(pairs)):
        n1 = start1[pairs[k, 0] + 1] - start1[pairs[k, 0]]
        n2 = start2[pairs[k, 1] + 1] - start2[pairs[k, 1]]
        total += min(n1 * n2, limit)
    out = np.empty((total, 2), np.int64)
    row, capped = 0, 0
    for k in range(len(pairs)):
        a = members1[start1[pairs[k, 0]] : start1[pairs[k, 0] + 1]]
        b = members2[start2[pairs[k, 1]] : start2[pairs[k, 1] + 1]]
        n = len(a) * len(b)
        if n <= limit:
            for i in a:
                for j in b:
                    out[row, 0], out[row, 1] = i, j
                    row += 1
            continue
        capped += 1
        similarity = np.empty(n, np.float32)
        for r in range(len(a)):
            for c in range(len(b)):
                similarity[r * len(b) + c] = -inner_product(d1[a[r]], d2[b[c]])
        order = np.argsort(similarity, kind="mergesort")
        for q in range(limit):
            out[row, 0], out[row, 1] = a[order[q] // len(b)], b[order[q] % len(b)]
            row += 1
    return out, capped


def putative_matches(
    clusters1: Clusters,
    clusters2: Clusters,
    descriptors1: Float32Array,
    descriptors2: Float32Array,
    max_matches_per_cluster_pair: int = 400,
) -> PutativeMatches:
    """Return X, all member pairs of matched clusters; the descriptors, (N1, D) and (N2, D), are those clustered.

    Of a pair of clusters with more member pairs than the limit, only so many, the most similar ones, are kept. The
    paper has no such limit; two brick walls need one.
    """
    pairs = matched_clusters(clusters1, clusters2)
    members = (clusters1.members, clusters1.start, clusters2.members, clusters2.start)
    rows, capped = _member_pairs(pairs, *members, descriptors1, descriptors2, max_matches_per_cluster_pair)
    if capped:
        logger.debug("%d of %d cluster pairs cut to %d matches", capped, len(pairs), max_matches_per_cluster_pair)
    n1, n2 = len(descriptors1), len(descriptors2)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    candidates1 = np.bincount(rows[:, 0], minlength=n1)
    return PutativeMatches(
        feature1=np.ascontiguousarray(rows[:, 0]),
        feature2=np.ascontiguousarray(rows[:, 1]),
        start1=np.concatenate([[0], np.cumsum(candidates1)]).astype(np.int64),
        candidates1=candidates1.astype(np.int64),
        candidates2=np.bincount(rows[:, 1], minlength=n2).astype(np.int64),
    )
