from itertools import combinations

import numpy as np
import pytest

import naive
from epiprior.geometry import sampson_distance
from epiprior.ranking.votes import count_votes, frame_points, rough_fundamental_matrices
from synthetic import make_frames, same_matrix


def frames_under_similarity(rng, n, turn, zoom):
    """Features of an image and their exact images under a rotation, a zoom and a shift."""
    x1 = rng.uniform(0, 1000, (n, 2))
    c, s = np.cos(turn), np.sin(turn)
    A = zoom * np.array([[c, -s], [s, c]])
    scale, angle = rng.uniform(1, 8, n), rng.uniform(0, 6, n)
    columns = {"scale1": scale, "scale2": zoom * scale, "orientation1_rad": angle, "orientation2_rad": angle + turn}
    return make_frames(x1, x1 @ A.T + [30, 70], **columns, roll_rad=turn), A


@pytest.mark.parametrize("frame", ["feature", "2keypoint"])
@pytest.mark.parametrize("turn_deg", [0, 37, 90, -140])
def test_frame_points_follow_the_transformation(frame, turn_deg):
    frames, A = frames_under_similarity(np.random.default_rng(0), 10, np.radians(turn_deg), 1.7)
    y1, y2 = frame_points(frames, np.arange(5), np.arange(5, 10), frame=frame, radius=6.0)
    assert y1.shape == (5, 8, 2)
    np.testing.assert_allclose(y1 @ A.T + [30, 70], y2, atol=1e-8)
    np.testing.assert_allclose(y1[:, 0], frames.x1[:5])
    np.testing.assert_allclose(y1[:, 4], frames.x1[5:])
    if frame == "feature":
        reach = np.linalg.norm(y1[:, 1:4] - y1[:, :1], axis=2)
        np.testing.assert_allclose(reach, np.repeat(6 * frames.scale1[:5, None], 3, axis=1))


def test_rough_matrices_equal_the_naive_eight_point_algorithm():
    rng = np.random.default_rng(1)
    y1 = rng.uniform(0, 1000, (5, 8, 2))
    y2 = y1 + rng.uniform(-40, 40, (5, 8, 2))
    F = rough_fundamental_matrices(y1, y2)
    assert F.shape == (10, 3, 3)
    for f, (i, j) in zip(F, combinations(range(5), 2), strict=True):
        assert same_matrix(f, naive.eight_point(np.vstack([y1[i], y1[j]]), np.vstack([y2[i], y2[j]])), 1e-6)
        assert np.linalg.svd(f)[1][2] < 1e-9
    assert count_votes(np.empty((0, 3, 3)), np.zeros((4, 2)), np.zeros((4, 2)))[0].tolist() == [0] * 4
    assert count_votes(np.ones((2, 3, 3)), np.empty((0, 2)), np.empty((0, 2)))[0].shape == (0,)
    assert rough_fundamental_matrices(np.ones((1, 8, 2)), np.ones((1, 8, 2))).shape == (0, 3, 3)


def test_votes_equal_naive_and_do_not_depend_on_threads(monkeypatch):
    rng = np.random.default_rng(2)
    x1, x2 = rng.uniform(0, 1000, (2, 300, 2))
    F = rng.normal(size=(50, 3, 3)) * [[1e-3, 1e-3, 1], [1e-3, 1e-3, 1], [1, 1, 1000]]
    for threshold in (3.0, 40.0):
        sfm, weighted = count_votes(F, x1, x2, threshold)
        expected = np.array(naive.votes(F, x1, x2, threshold))
        # Single precision may decide a match that lies on the threshold the other way.
        distance = np.array([sampson_distance(f, x1, x2) for f in F])
        assert (np.abs(sfm - expected) <= (np.abs(distance - threshold) < 1e-3 * threshold).sum(axis=0)).all()
        assert expected.sum() > 20
        np.testing.assert_allclose(weighted, sfm)
        both = count_votes(F, x1, x2, threshold, np.repeat([0.25, 0.5], 25))[1]
        np.testing.assert_allclose(both, (weighted + count_votes(F[25:], x1, x2, threshold)[1]) / 4, rtol=1e-5)
        with monkeypatch.context() as patch:
            patch.setattr("os.cpu_count", lambda: 1)
            again = count_votes(F, x1, x2, threshold)
        np.testing.assert_array_equal(again[0], sfm)
        np.testing.assert_array_equal(again[1], weighted)
