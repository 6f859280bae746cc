import numpy as np
import pytest

import naive
from epiprior.matching.clusters import cluster_features


def similar_groups(rng, groups, members, spread, d=12):
    x = np.repeat(rng.normal(size=(groups, d)), members, axis=0) + spread * rng.normal(size=(groups * members, d))
    x = rng.permutation(x).astype(np.float32)
    return x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("spread", [0.1, 0.35, 0.5])
def test_equals_naive_average_linkage(seed, spread):
    d = similar_groups(np.random.default_rng(seed), 4, 7, spread)
    found = cluster_features(d, 0.85)
    as_sets = sorted(tuple(sorted(np.flatnonzero(found.label == c).tolist())) for c in range(len(found)))
    assert as_sets == naive.average_linkage(d, 0.85)


def test_layout_and_numbering_of_many_one_and_no_cluster():
    d = similar_groups(np.random.default_rng(1), 5, 9, 0.2)
    found = cluster_features(d)
    first = [int(np.flatnonzero(found.label == c)[0]) for c in range(len(found))]
    assert first == sorted(first)
    for c in range(len(found)):
        members = found.members[found.start[c] : found.start[c + 1]]
        np.testing.assert_array_equal(members, np.flatnonzero(found.label == c))
        median = np.median(d[members], axis=0)
        np.testing.assert_allclose(found.representative[c], median / np.linalg.norm(median), atol=1e-5)
    d = np.ones((1300, 4), np.float32) / 2
    assert [len(cluster_features(each)) for each in (d, np.empty((0, 8), np.float32))] == [1, 0]
    assert cluster_features(np.ones((1, 1), np.float32)).label.tolist() == [0]
