import numpy as np
import pytest

from epiprior.matching.standard import nearest_neighbours, standard_table
from epiprior.presets import COHERENCE_COLUMNS, MATCH_COLUMNS, PAPER_TWO_KEYPOINT_COLUMNS
from epiprior.ranking.probabilities import best_rival, match_table, pair_columns, two_keypoint_scores, unite
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from synthetic import make_frames, make_putative, unit_rows


def test_union_holds_each_match_once_and_kpmd_fills_gaps_as_the_paper_says():
    rng = np.random.default_rng(0)
    d1, d2 = unit_rows(rng, 12, 6), unit_rows(rng, 12, 6)
    table = standard_table(*nearest_neighbours(d1, d2), (np.arange(12), np.arange(12)), 0.9)
    standard = list(zip(table.location1.tolist(), table.location2.tolist(), strict=True))
    X = make_putative({standard[0], standard[1], (0, 0), (11, 3), (5, 5)}, 12, 12)
    union = unite(X, table)
    pairs = list(zip(union.location1.tolist(), union.location2.tolist(), strict=True))
    in_x = list(zip(X.feature1.tolist(), X.feature2.tolist(), strict=True))
    assert pairs == sorted(set(in_x) | set(standard))
    sfm = np.arange(1, len(X) + 1)
    n = len(union)
    frames = make_frames(*rng.random((2, n, 2)), scale1=1 + rng.random(n), scale2=1 + rng.random(n))
    around = rng.random((len(union), 4))
    scores = (np.linspace(0, 1, len(X)), np.linspace(0, 2, len(X)))
    kpmd = match_table(union, frames, table, sfm, sfm / 2, scores, around, (0.9, 0.5, 0.2))
    assert kpmd.columns == MATCH_COLUMNS
    for row, pair in enumerate(pairs):
        votes, ratio, weight, mutual = kpmd.descriptors[row, :4]
        assert votes == (sfm[in_x.index(pair)] if pair in in_x else 0)
        k = standard.index(pair) if pair in standard else None
        assert ratio == pytest.approx(1.0 if k is None else table.distance_ratio[k])
        assert weight == pytest.approx(0.0 if k is None else table.similarity_weight[k])
        assert mutual == (k is not None and table.mutual[k])
    assert kpmd.column("relative_support").max() == 1
    assert kpmd.column("rivals").tolist() == [sum((a == p) != (b == q) for p, q in pairs) for a, b in pairs]
    np.testing.assert_allclose(kpmd.column("scale_change"), np.abs(np.log(frames.scale2 / frames.scale1)), rtol=1e-6)
    np.testing.assert_allclose(kpmd.select(COHERENCE_COLUMNS), around, rtol=1e-6)
    pair_wide = np.unique(kpmd.select(("pair_two_keypoints", "pair_support")), axis=0)
    np.testing.assert_allclose(pair_wide, [[0.5, 0.2]], rtol=1e-6)
    none = np.empty((0, 4), np.float32)
    table = standard_table(*nearest_neighbours(none, none), (np.empty(0, np.int64),) * 2, 0.9)
    union, frames = unite(make_putative(set(), 0, 0), table), make_frames(np.empty((0, 2)), np.empty((0, 2)))
    empty, around = np.empty(0), np.empty((0, 4))
    kpmd = match_table(union, frames, table, np.empty(0, np.int64), empty, (empty, empty), around, (0.0, 0.0, 0.0))
    assert kpmd.descriptors.shape == (0, len(MATCH_COLUMNS))


def test_columns_of_pairs_best_rivals_and_scores_of_2keypoints_equal_naive():
    strengths = np.array([0.9] * 10 + [0.1] * 2)
    pairs = [a * b for k, a in enumerate(strengths) for b in strengths[k + 1 :]]
    best, mean, support = pair_columns(strengths, np.array([3.0, sum(pairs) / 2]))
    assert (best, mean, support) == pytest.approx((0.9, strengths.mean(), 0.5))
    assert pair_columns(np.empty(0), np.empty(0)) == (0.0, 0.0, 0.0)
    assert pair_columns(np.array([0.7]), np.zeros(3)) == (0.7, 0.7, 0.0)
    rng = np.random.default_rng(1)
    feature, score = rng.integers(0, 15, 60), np.round(rng.random(60), 1)
    expected = [max([score[j] for j in range(60) if j != i and feature[j] == feature[i]], default=0) for i in range(60)]
    np.testing.assert_allclose(best_rival(score, feature), expected)
    assert best_rival(np.empty(0), np.empty(0, np.int64)).shape == (0,)
    rng = np.random.default_rng(2)
    main, other, p = rng.integers(0, 9, 30), rng.integers(0, 9, 30), rng.random(30)
    pairs = TwoKeypointMatches(main, other, PAPER_TWO_KEYPOINT_COLUMNS, np.zeros((30, 6), np.float32))
    mine = [np.concatenate([p[main == row], p[other == row]]) for row in range(10)]
    found = two_keypoint_scores(pairs, p, 10)
    np.testing.assert_allclose(found, [[each.max(initial=0) for each in mine], [each.sum() for each in mine]])
