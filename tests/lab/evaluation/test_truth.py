"""What is known of a pair: points, F, labels, difficulty, roll."""

from dataclasses import replace

import numpy as np
import pytest

from calls import refused
from epiprior.geometry import sampson_distance
from epiprior_lab.evaluation import truth as known
from epiprior_lab.evaluation.truth import evaluation_points, on_one_plane, pair_truth
from epiprior_lab.labels.ground_truth import TRUTH
from epiprior_lab.pairsets import DatasetError, read_pair_set, write_control_points
from synthetic import HEIGHT, WIDTH
from worlds import camera_pair, two_cameras


def test_points_of_a_pair_with_cameras_only_which_need_two_centres(tmp_path):
    pair = camera_pair(tmp_path, two_cameras())
    x1, x2 = evaluation_points(pair)
    assert len(x1) == len(x2) > 80
    assert sampson_distance(pair.fundamental(), x1, x2).max() < 1e-9
    for x in (x1, x2):
        assert ((x >= 0) & (x <= [WIDTH - 1, HEIGHT - 1])).all()
    assert np.ptp(x2, axis=0).min() > 300  # not all on one side
    assert sampson_distance(camera_pair(tmp_path, two_cameras((-2.0, 1.3, 0.4))).fundamental(), x1, x2).mean() > 10
    truth = pair_truth(pair, TRUTH)
    assert (truth.labels, truth.points) == ("epipolar", "cameras")
    np.testing.assert_allclose(truth.F, pair.fundamental())
    for cameras in (two_cameras((0.0, 0.0, 0.0)), (None, None)):
        refused(DatasetError, "'p'", evaluation_points, camera_pair(tmp_path, cameras))


def test_an_f_is_fitted_to_control_points_unless_they_lie_on_a_plane(pairs, relief, tmp_path):
    truth = pair_truth(pairs[0], TRUTH)
    assert (truth.labels, truth.points) == ("control_points", "control_points")
    assert sampson_distance(truth.F, truth.x1, truth.x2).max() < 0.1
    named = pair_truth(pairs[0], replace(TRUTH, one_plane=("relief-0",)))
    assert (named.labels, named.F) == ("", None)
    (tmp_path / "control_points").mkdir()
    (tmp_path / "images").symlink_to(relief / "images")
    (tmp_path / "pairs.csv").write_bytes((relief / "pairs.csv").read_bytes())
    x = np.random.default_rng(1).uniform(20, 300, (30, 2))
    for name in ("relief-0", "blank-0"):
        write_control_points(tmp_path / "control_points" / f"{name}.csv", x, x + [20.0, 0.0])
    flat = pair_truth(read_pair_set(tmp_path).pairs[0], TRUTH)
    assert (flat.labels, flat.F) == ("", None)
    rng = np.random.default_rng(0)
    x1 = rng.uniform(0, 500, (40, 2))
    x2 = x1 @ np.array([[0.9, 0.1], [-0.1, 1.1]]) + [20, -10] + rng.normal(0, 0.5, (40, 2))
    assert on_one_plane(x1, x2, 4.0)
    assert on_one_plane(x1[:4], x2[:4], 4.0)
    beside = x2.copy()
    beside[:2] += 40
    assert on_one_plane(x1, beside, 4.0)
    beside[:5, 0] += 60 * np.arange(1, 6)
    assert not on_one_plane(x1, beside, 4.0)


def test_difficulty():
    found = [TRUTH.difficulty(share) for share in (0.51, 0.5, 0.2, 0.19, np.nan)]
    assert found == ["easy", "medium", "medium", "hard", ""]


@pytest.mark.parametrize("degrees", [-150, -30, 0, 37, 90])
def test_true_roll_turns_directions_of_the_image(degrees, tmp_path):
    turn = np.deg2rad(degrees)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    pair = camera_pair(tmp_path, two_cameras((0.1, 0, 0), R=R))
    # A direction to the right in image 1 points down in image 2 after 90 degrees: clockwise on the screen.
    ahead, right = np.array([[0.0, 0, 1e6], [1e3, 0, 1e6]])
    (p, _), (q, _) = (pair.camera2.project(point[None]) for point in (ahead, right))
    step = (q - p)[0]
    assert np.degrees(np.arctan2(step[1], step[0])) == pytest.approx(degrees, abs=1e-6)
    assert known.true_roll_deg(pair) == pytest.approx(degrees)
