import numpy as np
import pytest

from epiprior.matching.clusters import Clusters
from epiprior.matching.putative import matched_clusters, putative_matches


def clusters_of(label, representative):
    label = np.array(label)
    members = np.argsort(label, kind="stable")
    start = np.searchsorted(label[members], np.arange(label.max() + 2))
    return Clusters(label, members, start, np.array(representative, np.float32))


def test_oversegmentation_in_one_image_is_bridged_and_no_clusters_have_no_matches():
    # The paper's figure: one cluster of image 2 is two clusters of image 1; both directions find both.
    one = clusters_of([0, 0, 1, 2], [[1, 0, 0], [0.9, 0.43589, 0], [0, 0, 1]])
    two = clusters_of([0, 0, 0, 1], [[0.95, 0.3122, 0], [0, 0, 1]])
    assert matched_clusters(one, two).tolist() == [[0, 0], [1, 0], [2, 1]]
    X = putative_matches(one, two, np.ones((4, 3), np.float32), np.ones((4, 3), np.float32))
    pairs = list(zip(X.feature1.tolist(), X.feature2.tolist(), strict=True))
    assert pairs == [(i, j) for i in range(3) for j in range(3)] + [(3, 3)]
    assert X.start1.tolist() == [0, 3, 6, 9, 10]
    assert X.candidates1.tolist() == X.candidates2.tolist() == [3, 3, 3, 1]
    none = Clusters(*(np.empty(0, np.int64),) * 2, np.zeros(1, np.int64), np.empty((0, 1), np.float32))
    X = putative_matches(none, clusters_of([0], [[1.0]]), np.empty((0, 1), np.float32), np.ones((1, 1), np.float32))
    assert (len(X), X.candidates2.tolist()) == (0, [0])


@pytest.mark.parametrize("limit", [1, 5, 11, 12, 100])
def test_the_cap_keeps_the_most_similar(limit):
    rng = np.random.default_rng(limit)
    d1, d2 = (rng.normal(size=(n, 6)).astype(np.float32) for n in (3, 4))
    one, two = clusters_of([0] * 3, [[1.0]]), clusters_of([0] * 4, [[1.0]])
    X = putative_matches(one, two, d1, d2, limit)
    best = np.argsort(-(d1 @ d2.T).ravel(), kind="stable")[:limit]
    assert sorted(best.tolist()) == (X.feature1 * 4 + X.feature2).tolist()
