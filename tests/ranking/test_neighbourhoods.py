from dataclasses import replace

import numpy as np
import pytest

import naive
from epiprior.presets import DEFAULT
from epiprior.ranking.neighbourhoods import NEAREST, SAME_CLUSTER, WITHIN, nearest_points, neighbourhoods
from synthetic import random_scene

FLAGS = {"nearest": NEAREST, "within": WITHIN, "cluster": SAME_CLUSTER}


@pytest.mark.parametrize("seed", range(4))
def test_neighbourhoods_equal_naive(seed):
    xy, scale, label = random_scene(seed)
    found = neighbourhoods(xy, scale, label, replace(DEFAULT, nearest_of_cluster=2, max_within=1000))
    for i, rules in enumerate(naive.neighbour_rules(xy, scale, label, 5, 5.0, 2)):
        part = slice(found.start[i], found.start[i + 1])
        got = dict(zip(found.neighbour[part].tolist(), found.rule[part].tolist(), strict=True))
        assert got == {j: sum(FLAGS[rule] for rule in how) for j, how in rules.items()}
        assert (np.diff(found.neighbour[part]) > 0).all()


def test_the_radius_rule_keeps_the_nearest_up_to_its_cap_and_ties_are_broken_by_index():
    xy, scale, label = random_scene(0)
    found = neighbourhoods(xy, scale * 50, label, replace(DEFAULT, nearest=0, nearest_of_cluster=0, max_within=7))
    assert (np.diff(found.start) == 7).all()
    assert set(found.neighbour[:7].tolist()) == set(np.argsort(np.hypot(*(xy - xy[0]).T))[1:8].tolist())
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    distance, index = nearest_points(square, square[:1], 9)
    assert (index.tolist(), distance.tolist()) == ([[0, 1, 2, 3, 4]], [[0, 1, 1, 1, 1]])
    assert len(neighbourhoods(np.empty((0, 2)), np.empty(0), np.empty(0, np.int64)).neighbour) == 0
