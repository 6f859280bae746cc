"""Alarms on planes, rotations, lines and identical images; none where something decides F."""

from __future__ import annotations

import numpy as np
import pytest

from epiprior.degeneracy import fit_homography, homography_distance, why_degenerate
from epiprior.estimators import fit
from epiprior.types import FloatArray, MatchSet
from synthetic import make_matches, make_pair, project, rotation


def why(matches: MatchSet, name: str = "usac") -> str:
    F = fit(name, matches).F
    assert F is not None
    return why_degenerate(F, matches.x1, matches.x2)


def facade(depth: float, share: float, seed: int, noise_px: float = 0.3) -> MatchSet:
    """A facade 10 units away, `share` of its points set back by `depth`; 100 outliers, random order."""
    rng = np.random.default_rng(seed)
    X = rng.uniform([-4, -3, 10], [4, 3, 10], (200, 3))
    X[rng.random(200) < share, 2] += depth
    R = rotation((0.1, 1.0, 0.05), 12.0)
    x1, x2 = project(X, np.eye(3), np.zeros(3)), project(X, R, -R @ np.array([2.2, 0.3, -0.4]))
    o1, o2 = rng.uniform(0, [1024, 768], (2, 100, 2))
    walk = rng.permutation(300)
    y1, y2 = (x + rng.normal(0, noise_px, x.shape) for x in (x1, x2))
    return make_matches(np.concatenate([y1, o1])[walk], np.concatenate([y2, o2])[walk])


@pytest.mark.parametrize("outliers", [0, 100, 500])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scene", ["plane", "rotation"])
def test_one_homography_raises_an_alarm(scene, seed, outliers):
    assert "homography" in why(make_pair(scene=scene, outliers=outliers, seed=seed).matches)


def test_noise_on_a_plane_is_no_relief():
    alarms = [why(make_pair(scene="plane", noise_px=1.0, seed=seed).matches) != "" for seed in range(10)]
    assert np.mean(alarms) >= 0.7


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [{"inliers": 200, "outliers": 100}, {"inliers": 20, "outliers": 20}])
def test_relief_raises_none(size, seed):
    assert why(make_pair(**size, seed=seed).matches) == ""


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("off_plane", [12, 30])
def test_a_few_matches_off_the_plane_decide(off_plane, seed):
    pair = make_pair(scene="plane+", off_plane=off_plane, seed=seed)
    assert why_degenerate(pair.F, pair.matches.x1, pair.matches.x2) == ""


@pytest.mark.parametrize("seed", range(5))
def test_two_matches_off_the_plane_do_not(seed):
    pair = make_pair(scene="plane+", off_plane=2, seed=seed)
    assert "homography" in why_degenerate(pair.F, pair.matches.x1, pair.matches.x2)


@pytest.mark.parametrize("seed", range(5))
def test_facade_with_recessed_windows_raises_none(seed):
    assert why(facade(0.4, 0.3, seed)) == ""


def test_relief_below_the_threshold_of_the_plane_is_seen_by_its_direction():
    """Parallax of 3 px: nearly every inlier lies within 4 px of one homography, F is still decided."""
    F = make_pair().F
    shallow, flat = (facade(depth, 0.3, 0, noise_px=0.2) for depth in (0.15, 0.0))
    H = fit_homography(shallow.x1, shallow.x2, 4.0)
    assert H is not None
    assert np.count_nonzero(homography_distance(H, shallow.x1, shallow.x2) < 4.0) >= 195
    assert why_degenerate(F, shallow.x1, shallow.x2) == ""
    assert "homography" in why_degenerate(F, flat.x1, flat.x2)


@pytest.mark.parametrize("seed", range(3))
def test_collinear_points(seed):
    assert why(make_pair(scene="line", outliers=0, seed=seed).matches)


def test_collinear_in_one_image_only():
    pair = make_pair(scene="plane", inliers=100, outliers=0)
    x1 = pair.matches.x1.copy()
    x1[:, 1] = 0.3 * x1[:, 0] + 40
    reason = why_degenerate(pair.F, x1, _on_epipolar_lines(pair.F, x1))
    assert reason == "the inliers lie on one line in image 1"


def _on_epipolar_lines(F: FloatArray, x1: FloatArray) -> FloatArray:
    line = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    u = np.random.default_rng(0).uniform(0, 1024, len(x1))
    return np.column_stack([u, -(line[:, 0] * u + line[:, 2]) / line[:, 1]])


def test_identical_images():
    matches = make_pair(inliers=100, outliers=0).matches
    F = make_pair().F
    skew = np.array([[0, -1.0, 300], [1.0, 0, -200], [-300, 200, 0]])
    assert "nothing moved" in why_degenerate(skew, matches.x1, matches.x1)
    assert why_degenerate(F, matches.x1[:0], matches.x1[:0])


def test_homography_is_found_among_outliers():
    pair = make_pair(scene="plane", noise_px=0.2)
    H = fit_homography(pair.matches.x1, pair.matches.x2, 4.0)
    assert H is not None
    distance = homography_distance(H, pair.matches.x1, pair.matches.x2)
    assert distance[pair.right].max() < 2.0
    assert np.median(distance[~pair.right]) > 20


def test_homography_of_three_points_is_none():
    x = np.array([[0.0, 0], [1, 0], [0, 1]])
    assert fit_homography(x, x, 4.0) is None


def test_homography_distance_is_the_smaller_one():
    H = np.diag([2.0, 2.0, 1.0])
    x1, x2 = np.array([[10.0, 10.0]]), np.array([[24.0, 20.0]])
    assert homography_distance(H, x1, x2) == pytest.approx([2.0])
    assert homography_distance(np.zeros((3, 3)), x1, x2) == pytest.approx([np.inf])
