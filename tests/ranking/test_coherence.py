"""Coherence against its naive twin, and what it is for: telling a match that moves with its surroundings."""

import numpy as np
import pytest

import naive
from epiprior.presets import COHERENCE_COLUMNS
from epiprior.ranking.coherence import FAR, NEAR, coherence, descriptor_weights
from synthetic import make_frames


def turned(x, roll_rad, scale):
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return scale * x @ np.array([[c, s], [-s, c]]) + 40.0


@pytest.mark.parametrize(("places", "roll"), [(60, 1.2), (30, -0.4), (10, 0.0), (2, 0.0)])
def test_equals_naive(places, roll):
    rng = np.random.default_rng(places)
    m = 3 * places
    location1 = rng.permutation(m) % places
    x1 = rng.uniform(0, 500, (places, 2))[location1]
    x2 = turned(x1, roll, 1.3) + rng.normal(0, 20, (m, 2)) * rng.integers(0, 2, (m, 1))
    scale1, scale2 = rng.uniform(1, 3, m), rng.uniform(1, 4, m)
    weights = rng.random(m) * rng.integers(0, 2, m)
    found = coherence(make_frames(x1, x2, scale1=scale1, scale2=scale2, roll_rad=roll), location1, weights)
    wanted = naive.coherence(x1, x2, scale1, scale2, location1, weights, roll, NEAR, FAR)
    assert found.shape == (m, len(COHERENCE_COLUMNS))
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_match_that_moves_with_its_surroundings_stands_out_unless_it_has_none():
    x1 = np.random.default_rng(0).uniform(0, 300, (60, 2))
    x2 = turned(x1, 0.5, 1.5)
    x2[0] += [80.0, 0.0]  # one match was taken for its neighbour
    found = coherence(make_frames(x1, x2, scale2=np.full(60, 1.5), roll_rad=0.5), np.arange(60), np.full(60, 0.5))
    assert found[1:, 3].min() > 0.8 > 0.5 > found[0, 3]
    assert (found[:, 0] <= found[:, 2] + 1e-12).all()
    assert not coherence(make_frames([[1.0, 1.0]], [[2.0, 2.0]]), np.zeros(1, np.int64), np.ones(1)).any()
    none = np.empty((0, 2))
    assert coherence(make_frames(none, none), np.empty(0, np.int64), np.empty(0)).shape == (0, len(COHERENCE_COLUMNS))
    far = make_frames([[0.0, 0.0], [900.0, 0.0]], [[0.0, 0.0], [900.0, 0.0]])
    assert not coherence(far, np.arange(2), np.ones(2)).any()


def test_descriptor_weights_share_and_trust_the_ratio():
    location1, location2 = np.array([0, 0, 1, 2]), np.array([0, 1, 2, 3])
    similarity, ratio = np.array([0.9, 0.7, 0.3, 0.3]), np.array([1.0, 1.0, 0.8, 1.0])
    assert descriptor_weights(location1, location2, similarity, ratio) == pytest.approx([0.5, 0.25, 0.5, 0.0])
    nothing = np.empty(0, np.int64)
    assert descriptor_weights(nothing, nothing, np.empty(0), np.empty(0)).shape == (0,)
