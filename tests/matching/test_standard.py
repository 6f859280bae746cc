import numpy as np
import pytest

import naive
from epiprior.matching.standard import mutual_mask, nearest_neighbours, similarity_weights, standard_table
from synthetic import unit_rows


@pytest.mark.parametrize(("n1", "n2"), [(7, 11), (600, 30), (1, 1), (5, 1)])
def test_both_directions_equal_the_naive_search(n1, n2):
    rng = np.random.default_rng(n1)
    d1, d2 = unit_rows(rng, n1, 16), unit_rows(rng, n2, 16)
    S = d1 @ d2.T
    for side, table in zip(nearest_neighbours(d1, d2), (S, S.T), strict=True):
        nearest, best, second = naive.two_best(table)
        np.testing.assert_array_equal(side.nearest, nearest)
        np.testing.assert_allclose(side.best, best, rtol=1e-5)
        np.testing.assert_allclose(side.second, second, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("n1", "n2"), [(0, 4), (4, 0), (0, 0)])
def test_no_features_on_a_side(n1, n2):
    rng = np.random.default_rng(0)
    forward, backward = nearest_neighbours(unit_rows(rng, n1, 16), unit_rows(rng, n2, 16))
    assert (forward.nearest.tolist(), backward.nearest.tolist()) == ([-1] * n1, [-1] * n2)
    assert not mutual_mask(forward, backward).any()
    assert similarity_weights(forward, backward).shape == (n1,)


def test_distance_ratio_is_of_angles_and_similarity_weight_as_printed():
    d1 = np.array([[1, 0]], np.float32)
    d2 = np.array([[np.cos(0.1), np.sin(0.1)], [np.cos(0.4), np.sin(0.4)]], np.float32)
    assert nearest_neighbours(d1, d2)[0].distance_ratio == pytest.approx([0.25], rel=1e-3)
    assert nearest_neighbours(d1, d1[[0, 0]])[0].distance_ratio.tolist() == [1.0]
    rng = np.random.default_rng(3)
    d1, d2 = unit_rows(rng, 40, 4), unit_rows(rng, 50, 4)
    forward, backward = nearest_neighbours(d1, d2)
    weights = similarity_weights(forward, backward)
    S = d1 @ d2.T
    positive = 0
    for i in range(40):
        j = int(S[i].argmax())
        if int(S[:, j].argmax()) != i or S[i, j] <= 0:
            assert weights[i] == 0
            continue
        m, m1, m2 = S[i, j], np.sort(S[:, j])[-2], np.sort(S[i])[-2]
        expected = (1 - np.exp(-m)) ** 2 * (1 - max(m1, 0) / m) * (1 - max(m2, 0) / m)
        assert weights[i] == pytest.approx(expected, rel=1e-4, abs=1e-7)
        positive += 1
    assert positive > 5


def naive_table(d1, d2, of1, of2, limit):
    S = d1 @ d2.T
    forward, backward = nearest_neighbours(d1, d2)
    weights = similarity_weights(forward, backward)
    rows = {}

    def ratio(sims):
        top = np.sort(sims)[::-1]
        return np.arccos(top[0]) / np.arccos(top[1])

    for i in range(len(d1)):
        j = int(S[i].argmax())
        mutual = int(S[:, j].argmax()) == i
        r = ratio(S[i])
        if r <= limit or mutual:
            old = rows.get((of1[i], of2[j]), (1.0, 0.0, False))
            rows[of1[i], of2[j]] = (min(old[0], r if r <= limit else 1.0), max(old[1], weights[i]), old[2] or mutual)
    back = {}
    for j in range(len(d2)):
        i = int(S[:, j].argmax())
        key = (of1[i], of2[j])
        back[key] = min(back.get(key, 1.0), ratio(S[:, j]))
    return {key: (*value, back.get(key, 1.0)) for key, value in rows.items()}


@pytest.mark.parametrize("seed", range(3))
def test_standard_table_equals_naive(seed):
    rng = np.random.default_rng(seed)
    d1, d2 = unit_rows(rng, 60, 6), unit_rows(rng, 50, 6)
    of1, of2 = np.sort(rng.integers(0, 40, 60)), np.sort(rng.integers(0, 35, 50))
    of1, of2 = (np.unique(of, return_inverse=True)[1] for of in (of1, of2))
    table = standard_table(*nearest_neighbours(d1, d2), (of1, of2), 0.8)
    expected = naive_table(d1, d2, of1, of2, 0.8)
    keys = list(zip(table.location1.tolist(), table.location2.tolist(), strict=True))
    assert keys == sorted(expected)
    for k, key in enumerate(keys):
        ratio, weight, mutual, backward = expected[key]
        assert table.distance_ratio[k] == pytest.approx(ratio, rel=1e-3)
        assert table.similarity_weight[k] == pytest.approx(weight, rel=1e-3, abs=1e-9)
        assert table.mutual[k] == mutual
        assert table.distance_ratio_backward[k] == pytest.approx(backward, rel=1e-3)
    assert 0 < table.mutual.sum() < len(keys)
