"""Pairs that contradict each other: loops against a naive count, which pair goes, and what is not looked at."""

import itertools

import numpy as np
import pytest

from epiprior.collection import loops
from epiprior.collection.loops import Counts, contradicted_pairs, count_loops


def naive_counts(matches, xy, near):
    """Count as `count_loops`, by dictionaries."""
    of = {}
    for (one, two), rows in zip(((0, 1), (0, 2), (1, 2)), matches, strict=True):
        of[one, two] = dict(map(tuple, rows.tolist()))
        of[two, one] = {b: a for a, b in of[one, two].items()}
    closed = opened = 0
    for one, two, third in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        for a, b in of[one, two].items():
            if a in of[one, third] and b in of[two, third]:
                meet = xy[third][of[one, third][a]] - xy[third][of[two, third][b]]
                together = np.hypot(*meet) < near
                closed += together
                opened += not together
    return closed, opened


@pytest.mark.parametrize("seed", range(6))
def test_counts_equal_the_naive_ones(seed):
    rng = np.random.default_rng(seed)
    sizes = [50, 55, 60]
    xy = tuple(rng.uniform(0, 40, (size, 2)) for size in sizes)
    matches = []
    for a, b in itertools.combinations(range(3), 2):
        rows = np.column_stack([rng.permutation(sizes[k])[:50] for k in (a, b)])
        rows[:10] = np.arange(10)[:, None]  # some agree
        matches.append(rows[np.unique(rows[:, 0], return_index=True)[1]])
        matches[-1] = matches[-1][np.unique(matches[-1][:, 1], return_index=True)[1]]
    found = count_loops(tuple(matches), xy)
    assert (found.closed, found.open) == naive_counts(matches, xy, 8.0)
    assert found.closed > 5
    assert found.open > 5
    (ab, ac, bc), (a, b, c) = matches, xy
    turned = (bc, ab[:, ::-1].copy(), ac[:, ::-1].copy())
    assert count_loops(turned, (b, c, a)) == found


def test_triplets_vote_where_it_is_not_chance():
    votes = [Counts(*counts).vote for counts in ((0, 0), (0, 3), (30, 0), (240, 60), (225, 75), (255, 45))]
    assert votes == [0.0] * 6
    assert Counts(0, 6).vote == Counts(200, 100).vote < 0 < Counts(42, 0).vote == Counts(900, 100).vote


def world(wrong, sure=None, images=4):
    """Matches of images of one scene, 30 features each, but for the pairs in `wrong`: each its own shift."""
    xy = np.column_stack([np.arange(30) * 20.0, np.zeros(30)])
    pairs = list(itertools.combinations(range(images), 2))
    matches = {pair: np.column_stack([np.arange(30)] * 2) for pair in pairs}
    for shift, pair in enumerate(wrong, start=1):
        matches[pair] = np.column_stack([np.arange(30 - shift), np.arange(shift, 30)])
    confidence = dict.fromkeys(pairs, 0.9) | (sure or {})
    return contradicted_pairs(confidence, matches.__getitem__, lambda image: xy)


def test_wrong_pairs_go_though_they_are_as_sure_as_others():
    assert world([]) == set()
    for pair in itertools.combinations(range(4), 2):
        assert world([pair]) == {pair}
        assert world([pair], {pair: 0.95}) == {pair}
    assert world([(0, 1), (2, 3)], {(0, 1): 0.6, (2, 3): 0.6}) == {(0, 1), (2, 3)}


def test_a_pair_that_no_third_image_knows_stays():
    xy = np.zeros((3, 2))
    assert (
        contradicted_pairs({(0, 1): 0.6, (1, 2): 0.6}, lambda pair: np.zeros((0, 2), np.int64), lambda k: xy) == set()
    )


def test_votes_of_a_pair_that_is_out_are_taken_back_once():
    doubtful = {(0, 1): 0.5, (0, 2): 0.5}
    assert world([(0, 1), (2, 3)], {(2, 3): 0.995, **doubtful}, images=5) == {(0, 1), (2, 3)}
    assert world([(0, 1), (0, 2), (1, 2)], {(1, 2): 0.995, **doubtful}, images=5) == {(0, 1), (0, 2), (1, 2)}


def test_of_many_triplets_those_with_the_surest_pairs_are_looked_at(monkeypatch):
    monkeypatch.setattr(loops, "_MOST", 1)
    confidence = dict.fromkeys(itertools.combinations(range(4), 2), 0.7) | {(0, 3): 0.9, (1, 3): 0.9, (0, 1): 0.55}
    assert loops.triplets({pair: confidence[pair] for pair in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3))}) == [
        (0, 1, 2),
        (0, 1, 3),
    ]
    thirds = [triplet for triplet in loops.triplets(confidence) if {0, 1} <= set(triplet)]
    assert (0, 1, 3) in thirds
