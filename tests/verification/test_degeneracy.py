"""What a homography explains, what is left for F, and which kind of homography it is."""

import numpy as np
import pytest

from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray, Geometry
from epiprior.verification import degeneracy
from epiprior.verification.chance import chance_rate
from epiprior.verification.degeneracy import fit_homography, homography_distance, kind_of_homography, turn_likeness
from synthetic import HEIGHT, WIDTH, make_pair, on_epipolar_lines, project, rotation, skew

SIZES = ((WIDTH, HEIGHT), (WIDTH, HEIGHT))


def evidence(F: FloatArray, x1: FloatArray, x2: FloatArray) -> float:
    """How many random hypotheses are expected to have as many inliers off the plane."""
    inliers = sampson_distance(F, x1, x2) < 1.5
    H = fit_homography(x1[inliers], x2[inliers], 4.0)
    return degeneracy.off_plane_evidence(F, H, x1, x2, threshold_px=1.5, rate=chance_rate(F, x1, x2, 1.5))[1]


def facade(depth: float, noise_px: float = 0.2) -> tuple[FloatArray, FloatArray]:
    """A facade 10 units away, three in ten of its points set back by `depth`."""
    rng = np.random.default_rng(0)
    X = rng.uniform([-4, -3, 10], [4, 3, 10], (200, 3))
    X[rng.random(200) < 0.3, 2] += depth
    R = rotation((0.1, 1.0, 0.05), 12.0)
    x1, x2 = project(X, np.eye(3), np.zeros(3)), project(X, R, -R @ np.array([2.2, 0.3, -0.4]))
    return x1 + rng.normal(0, noise_px, x1.shape), x2 + rng.normal(0, noise_px, x2.shape)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("off_plane", "decides"), [(2, False), (12, True), (30, True)])
def test_a_few_matches_off_the_plane_decide_but_two_do_not(off_plane, decides, seed):
    pair = make_pair(scene="plane+", off_plane=off_plane, seed=seed)
    assert (evidence(pair.F, pair.matches.x1, pair.matches.x2) < 1) == decides


def inaccurate(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A plane with one of the F that it allows, and 60 matches that lie 5 to 12 px off it in any direction."""
    rng = np.random.default_rng(seed)
    matches = make_pair(scene="plane", outliers=20, seed=seed).matches
    H = fit_homography(matches.x1, matches.x2, 4.0)
    x1 = rng.uniform([100, 100], [900, 650], (60, 2))
    angle, length = rng.uniform(0, 2 * np.pi, 60), rng.uniform(5, 12, 60)
    x2 = np.column_stack([x1, np.ones(60)]) @ H.T
    x2 = x2[:, :2] / x2[:, 2:] + length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    epipole = np.append(rng.uniform(-2000, 3000, 2), 1.0)
    return skew(epipole) @ H, np.concatenate([matches.x1, x1]), np.concatenate([matches.x2, x2])


@pytest.mark.parametrize("seed", range(3))
def test_matches_of_the_plane_that_are_inaccurate_do_not_decide(seed):
    F, x1, x2 = inaccurate(seed)
    near = sampson_distance(F, x1[-60:], x2[-60:]) < 1.5
    assert near.sum() >= 8  # many more than of random matches
    assert evidence(F, x1, x2) > 1


def test_a_feature_with_a_match_on_the_plane_has_no_other():
    """Rivals of matches on the plane agree with F; alone they would decide it."""
    pair = make_pair(scene="plane", outliers=40)
    right = pair.matches.take(pair.right)
    rivals = on_epipolar_lines(pair.F, right.x1[:40])
    x1, x2 = np.concatenate([pair.matches.x1, right.x1[:40]]), np.concatenate([pair.matches.x2, rivals])
    assert evidence(pair.F, x1, x2) > 1
    x1[-40:] += np.array([7.0, 0.0])  # as features of their own
    x2[-40:] = on_epipolar_lines(pair.F, x1[-40:])
    assert evidence(pair.F, x1, x2) < 1e-3


def test_relief_below_the_threshold_of_the_plane_is_seen_by_its_direction_unless_features_are_located_no_better():
    """Parallax of 3 px: nearly every inlier lies within 4 px of one homography, F is still decided."""
    F = make_pair().F
    for depth, seen in ((0.15, True), (0.0, False)):
        x1, x2 = facade(depth)
        H = fit_homography(x1, x2, 4.0)
        assert np.count_nonzero(homography_distance(H, x1, x2) < 4.0) >= 195
        assert (degeneracy.parallax_by_chance(F, H, x1, x2) < 1e-5) == seen
    # On the plane but for every twentieth point, 0.1 px off along its epipolar line: nothing decides F.
    x1, x2 = facade(0.0, noise_px=0.0)
    H = fit_homography(x1, x2, 4.0)
    line = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    along = np.column_stack([-line[:, 1], line[:, 0]]) / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    x2[::20] += 0.1 * along[::20]
    assert degeneracy.parallax_by_chance(F, H, x1, x2) > 0.4


@pytest.mark.parametrize(("scene", "kind"), [("plane", Geometry.PLANAR), ("rotation", Geometry.ROTATION)])
def test_planes_and_turning_cameras_have_different_homographies(scene, kind):
    m = make_pair(scene=scene, outliers=0).matches
    H = fit_homography(m.x1, m.x2, 4.0)
    assert kind_of_homography(H, m.x1, m.x2, SIZES) is kind
    assert (turn_likeness(H, SIZES) > 0.97) == (scene == "rotation")
    assert turn_likeness(H, None) == -1


@pytest.mark.parametrize("degrees", [0, 90, 33])
def test_copies_are_scaled_turned_and_shifted(degrees):
    rng = np.random.default_rng(1)
    x1 = rng.uniform(0, 700, (80, 2))
    c, s = 0.6 * np.cos(np.deg2rad(degrees)), 0.6 * np.sin(np.deg2rad(degrees))
    x2 = x1 @ np.array([[c, s], [-s, c]]) + [30, -7] + rng.normal(0, 0.2, x1.shape)
    H = fit_homography(x1, x2, 4.0)
    assert degeneracy.similarity_residuals(x1, x2).max() < 1.5
    assert kind_of_homography(H, x1, x2, SIZES) is Geometry.IDENTICAL


def beside_line_slowly(x, threshold_px):
    near = x
    for _ in range(5):
        centre = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov(near - centre, rowvar=False, bias=True))[1][:, 0]
        distance = np.abs((x - centre) @ normal)
        near = x[distance <= max(threshold_px, float(np.median(distance)))]
    return np.mean(distance >= threshold_px)


@pytest.mark.parametrize("on_line", [0.0, 0.3, 0.6, 1.0])
def test_points_near_a_line_are_those_of_the_slow_way(on_line):
    for seed in range(30):
        rng = np.random.default_rng(seed)
        x = rng.uniform(0, 1000, (int(rng.integers(8, 200)), 2))
        line = rng.random(len(x)) < on_line
        turn = rng.uniform(0, np.pi)
        along = rng.normal(0, 200, (line.sum(), 1)) * [np.cos(turn), np.sin(turn)]
        x[line] = 500 + along + rng.normal(0, 1, along.shape)
        assert degeneracy.share_beside_line(x, 4.0) == beside_line_slowly(x, 4.0)
    assert degeneracy.share_beside_line(np.full((9, 2), 3.0), 4.0) == 0  # near any line through it
    x = np.column_stack([10.0 * np.arange(100), 4.0 * np.arange(100)])
    assert degeneracy.share_beside_line(x, 4.0) == degeneracy.share_beside_line(x[:0], 4.0) == 0
    x[::5, 1] += 100
    assert degeneracy.share_beside_line(x, 4.0) == pytest.approx(0.2)


def test_homography_is_found_among_outliers_and_its_distance_is_the_smaller_one():
    pair = make_pair(scene="plane", noise_px=0.2)
    H = fit_homography(pair.matches.x1, pair.matches.x2, 4.0)
    distance = homography_distance(H, pair.matches.x1, pair.matches.x2)
    assert distance[pair.right].max() < 2.0 < 20 < np.median(distance[~pair.right])
    assert fit_homography(pair.matches.x1[:3], pair.matches.x2[:3], 4.0) is None
    H = np.diag([2.0, 2.0, 1.0])
    x1, x2 = np.array([[10.0, 10.0]]), np.array([[24.0, 20.0]])
    assert homography_distance(H, x1, x2) == pytest.approx([2.0])
    assert homography_distance(np.zeros((3, 3)), x1, x2) == pytest.approx([np.inf])
