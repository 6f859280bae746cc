from dataclasses import replace

import numpy as np
import pytest

import naive
from epiprior.presets import COHERENCE_COLUMNS, DEFAULT, PAPER_TWO_KEYPOINT_COLUMNS, TWO_KEYPOINT_COLUMNS
from epiprior.ranking.neighbourhoods import neighbourhoods
from epiprior.ranking.two_keypoints import best_two_keypoint_matches, describe_two_keypoint_matches, match_two_keypoints
from synthetic import make_frames, make_putative, random_scene


def random_pair(seed, m=400):
    scenes = random_scene(seed), random_scene(seed + 100)
    rng = np.random.default_rng(seed)
    X = make_putative({(int(a), int(b)) for a, b in rng.integers(0, 60, (m, 2))}, 60, 60)
    columns = {"roll_rad": 0.3}
    for k, (scene, feature) in enumerate(zip(scenes, (X.feature1, X.feature2), strict=True), start=1):
        columns[f"x{k}"], columns[f"scale{k}"] = scene[0][feature], scene[1][feature]
        columns[f"orientation{k}_rad"] = rng.uniform(0, 6, 60)[feature]
    columns |= {name: rng.uniform(-1, 1, len(X)) for name in ("similarity", "fixed_similarity")}
    around = (neighbourhoods(*scene, replace(DEFAULT, max_within=1000)) for scene in scenes)
    return *scenes, X, make_frames(**columns), *match_two_keypoints(X, *around)


@pytest.mark.parametrize("seed", range(2))
def test_matches_and_descriptors_equal_naive(seed):
    scene1, scene2, X, frames, main, other = random_pair(seed)
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
            *(scene1[0][p1], scene1[0][n1], scene2[0][p2], scene2[0][n2]),
            np.degrees([frames.orientation1_rad[m], frames.orientation2_rad[m]]),
            [frames.scale1[m], frames.scale2[m]],
        )
        n1_count = sum((q[0], q[1]) == (p1, n1) for q in found)
        n2_count = sum((q[2], q[3]) == (p2, n2) for q in found)
        expected_row = [n1_count, n2_count, ratio, angle, scene1[2][p1] == scene1[2][n1], least]
        np.testing.assert_allclose(described.descriptors[row], expected_row, rtol=1e-4, atol=1e-5)


def test_extended_columns_and_that_a_pair_and_its_swap_count_once():
    _, _, X, frames, main, other = random_pair(1)
    around = np.random.default_rng(2).random((len(X), 4))
    table = describe_two_keypoint_matches(X, frames, main, other, np.zeros(len(main), bool), around)
    assert table.columns == TWO_KEYPOINT_COLUMNS
    changes = np.log(frames.scale2 / frames.scale1)
    wanted = np.abs(changes[main] - changes[other])
    np.testing.assert_allclose(table.select(("scale_change_difference",))[:, 0], wanted, atol=1e-5)
    assert np.abs(table.select(("turn_difference", "roll_error_main"))).max() <= np.pi + 1e-5
    for name, rows in (("main", main), ("neighbour", other)):
        columns = tuple(f"{column}_{name}" for column in COHERENCE_COLUMNS)
        np.testing.assert_allclose(table.select(columns), around[rows], rtol=1e-6)
    pairs = describe_two_keypoint_matches(X, frames, main, other, np.zeros(len(main), bool))
    probability = np.round(np.random.default_rng(0).random(len(pairs)), 1)
    chosen = best_two_keypoint_matches(pairs, probability, 30)
    assert len({frozenset((int(main[k]), int(other[k]))) for k in chosen}) == len(chosen) == 30
    agreement = pairs.select(("distance_ratio", "angle_difference")) @ np.array([-1.0, 1.0 / np.pi])
    key = [(-probability[k], agreement[k], k) for k in chosen]
    assert key == sorted(key)
    assert probability[chosen].min() >= np.sort(probability)[::-1][59]
    assert len(random_pair(0, m=0)[-1]) == 0
