import numpy as np
import pytest

import naive
from epiprior.presets import MATCH_COLUMNS, SECOND_ROUND_COLUMNS
from epiprior.ranking import second_round
from epiprior.ranking.probabilities import MatchTable, Union
from epiprior.ranking.second_round import second_round_rows, second_round_table
from synthetic import make_frames, make_pair


def union_of(first, second=None):
    """Matches that are neither putative nor standard, and no descriptors but zeros."""
    nowhere = np.full(len(first), -1)
    union = Union(first, first if second is None else second, nowhere, nowhere)
    return union, MatchTable(MATCH_COLUMNS, np.zeros((len(first), len(MATCH_COLUMNS)), np.float32))


@pytest.fixture(scope="module")
def described():
    """Two hundred matches, half of them right and probable; rough matrices near the true one and random ones."""
    pair = make_pair(inliers=100, outliers=100, seed=3)
    rng = np.random.default_rng(4)
    right = pair.right
    probability = np.where(right, rng.uniform(0.5, 0.99, 200), rng.uniform(0.0, 0.4, 200))
    near = pair.F + 1e-3 * np.abs(pair.F) * rng.normal(size=(6, 3, 3))
    matrices = np.concatenate([rng.normal(size=(5, 3, 3)), near])
    frames = make_frames(pair.matches.x1, pair.matches.x2)
    union, _ = union_of(np.arange(200), np.append(np.arange(199), 0))
    table = MatchTable(MATCH_COLUMNS, rng.random((200, len(MATCH_COLUMNS)), np.float32))
    rows = second_round_rows(probability, 150)
    return rows, right, probability, table, second_round_table(rows, union, frames, table, probability, matrices)


def test_the_most_probable_matches_are_described_and_right_ones_are_near_the_best_f(described):
    rows, right, probability, table, found = described
    assert (found.columns, found.descriptors.shape) == (SECOND_ROUND_COLUMNS, (150, len(SECOND_ROUND_COLUMNS)))
    assert set(rows) == set(np.argsort(-probability)[:150])
    np.testing.assert_allclose(found.column("probability"), np.sort(probability)[::-1][:150], rtol=1e-6)
    np.testing.assert_array_equal(found.select(MATCH_COLUMNS), table.descriptors[rows])
    np.testing.assert_allclose(found.column("rank"), np.log1p(np.arange(150)), rtol=1e-6)
    rival = found.column("best_rival2")[list(rows).index(0)] if 0 in rows else probability[199]
    assert rival == pytest.approx(probability[199], rel=1e-6)
    assert not found.column("best_rival1").any()
    near = np.expm1(found.column("distance_best"))
    assert np.median(near[right[rows]]) < 1.5 < np.median(near[~right[rows]])
    for name in ("refined_votes", "evidence_without"):
        assert found.column(name)[right[rows]].mean() > found.column(name)[~right[rows]].mean()
        assert 0 <= found.column(name).min() <= found.column(name).max() <= 1
    assert len(np.unique(found.select(SECOND_ROUND_COLUMNS[-4:]), axis=0)) == 1


def test_a_match_alone_does_not_confirm_the_f_that_it_made(monkeypatch):
    """Without itself, the F that only one match supports is worth nothing to it."""
    rng = np.random.default_rng(0)
    F = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # matches stay in their row
    monkeypatch.setattr(second_round, "_leading_models", lambda *_: F[None])
    x1 = rng.uniform(0, 500, (20, 2))
    x2 = x1 + np.array([5.0, 60.0])
    x2[7, 1] = x1[7, 1]
    frames, p = make_frames(x1, x2), np.full(20, 0.5)
    union, table = union_of(np.arange(20))
    found = second_round_table(np.arange(20), union, frames, table, p, F[None])
    assert np.expm1(found.column("distance_best"))[7] == pytest.approx(0, abs=1e-6)
    assert found.column("evidence_without")[7] == pytest.approx(0, abs=1e-6)
    x2[3:12, 1] = x1[3:12, 1]
    found = second_round_table(np.arange(20), union, make_frames(x1, x2), table, p, F[None])
    assert found.column("evidence_without")[7] == pytest.approx(8 / 9, rel=1e-5)
    distance = [naive.sampson(F, a, b) for a, b in zip(x1, x2, strict=True)]
    np.testing.assert_allclose(np.expm1(found.column("distance_best")), np.minimum(distance, 100), rtol=1e-5, atol=1e-6)


def test_agreement_in_image_2_is_that_in_image_1_of_the_swapped_pair(described):
    pair = make_pair(inliers=60, outliers=20, seed=5)
    p = np.random.default_rng(1).uniform(0.1, 0.9, 80)
    index = np.arange(80)
    union, table = union_of(index)
    scale = np.random.default_rng(2).uniform(1, 3, 80)
    one = make_frames(pair.matches.x1, pair.matches.x2, scale1=scale, roll_rad=0.3)
    other = make_frames(pair.matches.x2, pair.matches.x1, scale2=scale, roll_rad=-0.3)
    both = ((one, pair.F), (other, pair.F.T))
    a, b = (second_round_table(index, union, frames, table, p, F[None]) for frames, F in both)
    names = [name for name in SECOND_ROUND_COLUMNS if name.startswith("probable_")]
    first, second = tuple(names[:4]), tuple(names[4:])
    np.testing.assert_allclose(a.select(second), b.select(first), rtol=1e-5)
    assert a.select(first).any()


@pytest.mark.parametrize("count", [0, 9])
def test_without_matches_or_matrices_nothing_fails(count):
    index = np.arange(count)
    union, table = union_of(index)
    frames = make_frames(*np.random.default_rng(0).uniform(0, 99, (2, count, 2)))
    found = second_round_table(index, union, frames, table, np.full(count, 0.5), np.empty((0, 3, 3)))
    assert found.descriptors.shape == (count, len(SECOND_ROUND_COLUMNS))
    assert np.isfinite(found.descriptors).all()
