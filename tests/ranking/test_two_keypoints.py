import numpy as np
import pytest

import naive
from epiprior.matching.putative import PutativeMatches
from epiprior.presets import COHERENCE_COLUMNS, PAPER_TWO_KEYPOINT_COLUMNS, TWO_KEYPOINT_COLUMNS
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.neighbourhoods import neighbourhoods
from epiprior.ranking.two_keypoints import best_two_keypoint_matches, describe_two_keypoint_matches, match_two_keypoints
from synthetic import random_scene


def random_X(seed, n1=60, n2=60, m=400):
    rng = np.random.default_rng(seed)
    rows = np.unique(np.column_stack([rng.integers(0, n1, m), rng.integers(0, n2, m)]), axis=0)
    counts = np.bincount(rows[:, 0], minlength=n1)
    return PutativeMatches(
        rows[:, 0].copy(),
        rows[:, 1].copy(),
        np.concatenate([[0], np.cumsum(counts)]),
        counts,
        np.bincount(rows[:, 1], minlength=n2),
    )


def frames_of(X, scene1, scene2, rng):
    m = len(X)
    return MatchFrames(
        x1=scene1[0][X.feature1],
        x2=scene2[0][X.feature2],
        scale1=scene1[1][X.feature1],
        scale2=scene2[1][X.feature2],
        orientation1_rad=rng.uniform(0, 6, 60)[X.feature1],
        orientation2_rad=rng.uniform(0, 6, 60)[X.feature2],
        similarity=rng.uniform(-1, 1, m),
        fixed_similarity=rng.uniform(-1, 1, m),
        roll_rad=0.3,
    )


@pytest.mark.parametrize("seed", range(4))
def test_matches_and_descriptors_equal_naive(seed):
    scene1, scene2 = random_scene(seed), random_scene(seed + 100)
    X = random_X(seed)
    rng = np.random.default_rng(seed)
    frames = frames_of(X, scene1, scene2, rng)
    around = [neighbourhoods(*scene, max_within=1000) for scene in (scene1, scene2)]
    main, other = match_two_keypoints(X, *around)
    rules = [naive.neighbour_rules(*scene, 5, 5.0, 1) for scene in (scene1, scene2)]
    pairs = list(zip(X.feature1.tolist(), X.feature2.tolist(), strict=True))
    expected = naive.two_keypoint_matches(pairs, *rules)
    found = [(pairs[m][0], pairs[o][0], pairs[m][1], pairs[o][1]) for m, o in zip(main, other, strict=True)]
    assert len(found) == len(set(found)) > 20
    assert set(found) == expected

    same = scene1[2][X.feature1[main]] == scene1[2][X.feature1[other]]
    described = describe_two_keypoint_matches(X, frames, main, other, same)
    assert described.columns == PAPER_TWO_KEYPOINT_COLUMNS
    for row, (p1, n1, p2, n2) in enumerate(found):
        m = main[row]
        ratio, angle, least = naive.two_keypoint_descriptor(
            scene1[0][p1],
            scene1[0][n1],
            scene2[0][p2],
            scene2[0][n2],
            np.degrees([frames.orientation1_rad[m], frames.orientation2_rad[m]]),
            [frames.scale1[m], frames.scale2[m]],
        )
        n1_count = sum((q[0], q[1]) == (p1, n1) for q in found)
        n2_count = sum((q[2], q[3]) == (p2, n2) for q in found)
        expected_row = [n1_count, n2_count, ratio, angle, scene1[2][p1] == scene1[2][n1], least]
        np.testing.assert_allclose(described.descriptors[row], expected_row, rtol=1e-4, atol=1e-5)


def test_extended_columns():
    scene1, scene2 = random_scene(1), random_scene(2)
    X = random_X(1)
    frames = frames_of(X, scene1, scene2, np.random.default_rng(1))
    main, other = match_two_keypoints(X, neighbourhoods(*scene1), neighbourhoods(*scene2))
    around = np.random.default_rng(2).random((len(X), 4))
    table = describe_two_keypoint_matches(X, frames, main, other, np.zeros(len(main), bool), around)
    assert table.columns == TWO_KEYPOINT_COLUMNS
    assert table.descriptors.shape == (len(main), len(TWO_KEYPOINT_COLUMNS))
    changes = np.log(frames.scale2 / frames.scale1)
    np.testing.assert_allclose(
        table.select(("scale_change_difference",))[:, 0], np.abs(changes[main] - changes[other]), atol=1e-5
    )
    turn = np.abs(table.select(("turn_difference", "roll_error_main")))
    assert turn.max() <= np.pi + 1e-5
    for name, rows in (("main", main), ("neighbour", other)):
        columns = tuple(f"{column}_{name}" for column in COHERENCE_COLUMNS)
        np.testing.assert_allclose(table.select(columns), around[rows], rtol=1e-6)


def test_a_pair_and_its_swap_count_once_and_ties_are_broken():
    scene1, scene2 = random_scene(1), random_scene(2)
    X = random_X(1)
    frames = frames_of(X, scene1, scene2, np.random.default_rng(1))
    main, other = match_two_keypoints(X, neighbourhoods(*scene1), neighbourhoods(*scene2))
    pairs = describe_two_keypoint_matches(X, frames, main, other, np.zeros(len(main), bool))
    probability = np.round(np.random.default_rng(0).random(len(pairs)), 1)
    chosen = best_two_keypoint_matches(pairs, probability, 30)
    assert len({frozenset((int(main[k]), int(other[k]))) for k in chosen}) == len(chosen) == 30
    key = [(-probability[k], pairs.descriptors[k, :2].sum(), k) for k in chosen]
    assert key == sorted(key)
    assert probability[chosen].min() >= np.sort(probability)[::-1][59]


def test_no_matches():
    X = random_X(0, m=0)
    main, _ = match_two_keypoints(X, neighbourhoods(*random_scene(0)), neighbourhoods(*random_scene(1)))
    assert len(main) == 0
