"""Alarms on planes, rotations, lines and identical images; none where something decides F."""

import numpy as np
import pytest

from epiprior.estimators import fit
from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray, MatchSet
from epiprior.verification.degeneracy import (
    DecidedLevels,
    PlaneEvidence,
    _near_line,
    fit_homography,
    homography_distance,
    why_degenerate,
)
from synthetic import make_matches, make_pair, on_epipolar_lines, project, rotation, skew


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


@pytest.mark.parametrize(("outliers", "seed"), [(0, 0), (100, 1), (500, 2)])
@pytest.mark.parametrize("scene", ["plane", "rotation"])
def test_one_homography_raises_an_alarm(scene, seed, outliers):
    assert "homography" in why(make_pair(scene=scene, outliers=outliers, seed=seed).matches)


def test_noise_on_a_plane_is_no_relief():
    alarms = [why(make_pair(scene="plane", noise_px=1.0, seed=seed).matches) != "" for seed in range(10)]
    assert np.mean(alarms) >= 0.7


@pytest.mark.parametrize("scene", ["plane", "rotation"])
def test_a_plane_of_few_matches_among_many_wrong_ones_raises_it_too(scene):
    for inliers, outliers in ((20, 10), (20, 100), (40, 100), (80, 100), (80, 500), (200, 500)):
        assert "homography" in why(make_pair(scene=scene, inliers=inliers, outliers=outliers, order=2.0).matches)


def inaccurate(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A plane with one of the F that it allows, and 60 matches that lie 5 to 12 px off it in any direction."""
    rng = np.random.default_rng(seed)
    matches = make_pair(scene="plane", outliers=20, seed=seed).matches
    H = fit_homography(matches.x1, matches.x2, 4.0)
    assert H is not None
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
    assert "homography" in why_degenerate(F, x1, x2)


def test_a_feature_with_a_match_on_the_plane_has_no_other():
    """Rivals of matches on the plane agree with F; alone they would decide it."""
    pair = make_pair(scene="plane", outliers=40)
    right = pair.matches.take(pair.right)
    rivals = on_epipolar_lines(pair.F, right.x1[:40])
    x1, x2 = np.concatenate([pair.matches.x1, right.x1[:40]]), np.concatenate([pair.matches.x2, rivals])
    assert "homography" in why_degenerate(pair.F, x1, x2)
    x1[-40:] += np.array([7.0, 0.0])  # as features of their own
    x2[-40:] = on_epipolar_lines(pair.F, x1[-40:])
    assert why_degenerate(pair.F, x1, x2) == ""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("outliers", [30, 200])
def test_few_right_matches_of_relief_raise_none(outliers, seed):
    pair = make_pair(inliers=25, outliers=outliers, seed=seed)
    assert why_degenerate(pair.F, pair.matches.x1, pair.matches.x2) == ""


def test_levels_decide_what_is_proof():
    found = PlaneEvidence(on_plane=90, off_plane=10, expected=3.0, parallax=1e-3)
    assert not found.decides()
    assert found.decides(DecidedLevels(expected=4.0))
    assert found.decides(DecidedLevels(parallax=1e-2))
    assert found.decides(DecidedLevels(off_plane_share=0.05))
    assert not found.decides(DecidedLevels(off_plane_share=0.1))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [{"inliers": 200, "outliers": 100}, {"inliers": 20, "outliers": 20}])
def test_relief_raises_none(size, seed):
    assert why(make_pair(**size, seed=seed).matches) == ""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("off_plane", "decides"), [(2, False), (12, True), (30, True)])
def test_a_few_matches_off_the_plane_decide_but_two_do_not(off_plane, decides, seed):
    pair = make_pair(scene="plane+", off_plane=off_plane, seed=seed)
    assert ("homography" in why_degenerate(pair.F, pair.matches.x1, pair.matches.x2)) == (not decides)


@pytest.mark.parametrize("seed", range(3))
def test_facade_with_recessed_windows_raises_none(seed):
    matches = facade(0.4, 0.3, seed)
    assert why_degenerate(make_pair().F, matches.x1, matches.x2) == ""


def test_relief_below_the_threshold_of_the_plane_is_seen_by_its_direction():
    """Parallax of 3 px: nearly every inlier lies within 4 px of one homography, F is still decided."""
    F = make_pair().F
    shallow, flat = (facade(depth, 0.3, 0, noise_px=0.2) for depth in (0.15, 0.0))
    H = fit_homography(shallow.x1, shallow.x2, 4.0)
    assert H is not None
    assert np.count_nonzero(homography_distance(H, shallow.x1, shallow.x2) < 4.0) >= 195
    assert why_degenerate(F, shallow.x1, shallow.x2) == ""
    assert "homography" in why_degenerate(F, flat.x1, flat.x2)


def test_collinear_points():
    assert why(make_pair(scene="line", outliers=0).matches)


def test_collinear_in_one_image_only():
    pair = make_pair(scene="plane", inliers=100, outliers=0)
    x1 = pair.matches.x1.copy()
    x1[:, 1] = 0.3 * x1[:, 0] + 40
    reason = why_degenerate(pair.F, x1, on_epipolar_lines(pair.F, x1))
    assert reason == "the inliers lie on one line in image 1"


def near_line_slowly(x, support, threshold_px):
    near = support
    for _ in range(5):
        centre = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov(near - centre, rowvar=False, bias=True))[1][:, 0]
        distance = np.abs((support - centre) @ normal)
        near = support[distance <= max(threshold_px, float(np.median(distance)))]
    return np.abs((x - centre) @ normal) < threshold_px


@pytest.mark.parametrize("on_line", [0.0, 0.3, 0.6, 1.0])
def test_points_near_a_line_are_those_of_the_slow_way(on_line):
    for seed in range(30):
        rng = np.random.default_rng(seed)
        x = rng.uniform(0, 1000, (int(rng.integers(8, 200)), 2))
        line = rng.random(len(x)) < on_line
        turn = rng.uniform(0, np.pi)
        along = rng.normal(0, 200, (line.sum(), 1)) * [np.cos(turn), np.sin(turn)]
        x[line] = 500 + along + rng.normal(0, 1, along.shape)
        support = x[: max(8, len(x) // 2)]
        assert np.array_equal(_near_line(x, support, 4.0), near_line_slowly(x, support, 4.0))


def test_points_at_one_place_are_near_any_line_through_it():
    x = np.full((9, 2), 3.0)
    assert _near_line(x, x, 4.0).all()


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
