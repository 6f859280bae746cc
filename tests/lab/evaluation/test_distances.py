"""Distances of fundamental matrices and errors of poses: exact geometry, and slow twins."""

import numpy as np
import pytest

from epiprior.geometry import normalise_fundamental
from epiprior_lab.evaluation.distances import points_on_lines, pose_errors, symmetric_distance
from epiprior_lab.pairsets import fundamental_from_cameras
from synthetic import HEIGHT, WIDTH
from worlds import points_before, two_cameras

SIZES = ((WIDTH, HEIGHT), (WIDTH, HEIGHT))


def naive_distance(F, other, sizes, points, seed):
    """One random point at a time; another draw, so equal only on average."""
    rng = np.random.default_rng(seed)
    totals = []
    for A, B in ((F, other), (other, F)):
        done = []
        while len(done) < points:
            x1 = np.append(rng.uniform(0, [sizes[0][0] - 1, sizes[0][1] - 1]), 1.0)
            line = A @ x1
            ends = []
            for value, axis in ((0, 0), (sizes[1][0] - 1, 0), (0, 1), (sizes[1][1] - 1, 1)):
                if abs(line[1 - axis]) < 1e-12:
                    continue
                other_value = -(line[2] + line[axis] * value) / line[1 - axis]
                if 0 <= other_value <= sizes[1][1 - axis] - 1:
                    ends.append((value, other_value) if axis == 0 else (other_value, value))
            if len(ends) < 2:
                continue
            p, q = np.array(ends[0]), np.array(ends[-1])
            x2 = np.append(p + rng.random() * (q - p), 1.0)
            second, first = B @ x1, B.T @ x2
            d2 = abs(second @ x2) / np.hypot(*second[:2]) / np.hypot(*sizes[1])
            d1 = abs(first @ x1) / np.hypot(*first[:2]) / np.hypot(*sizes[0])
            done.append(min(1.0, (d1 + d2) / 2))
        totals.append(np.mean(done))
    return np.mean(totals)


def test_distance_is_that_of_the_naive_twin_zero_for_the_same_and_symmetric_and_points_lie_on_lines():
    F, other = (fundamental_from_cameras(*two_cameras(t=t)) for t in ((-2.0, 0.3, 0.4), (-2.0, 0.6, 0.2)))
    found = symmetric_distance(F, other, SIZES, points=4000, seed=1)
    assert found == pytest.approx(naive_distance(F, other, SIZES, 3000, 2), rel=0.06)
    assert 0.01 < found < 0.5
    F, other = (fundamental_from_cameras(*two_cameras(angle=angle)) for angle in (15.0, 17.0))
    assert symmetric_distance(F, -3 * F, SIZES) < 1e-9
    there, back = symmetric_distance(F, other, SIZES, points=5000), symmetric_distance(other, F, SIZES, points=5000)
    assert there == pytest.approx(back, rel=0.05)
    assert symmetric_distance(F, other, SIZES, seed=3) == symmetric_distance(F, other, SIZES, seed=3)
    # Every epipolar line of image 2 is y = -50, outside: nothing in common.
    below = np.outer([0.0, 1.0, 50.0], [0.0, 0.0, 1.0])
    assert symmetric_distance(below, below, SIZES) == 1.0
    lines = np.array([[1.0, 0, -20], [0, 1, -30], [1, 1, -10], [1, 0, 5], [0, 0, 1]])
    x, met = points_on_lines(lines, (100, 80), np.array([0.0, 0.5, 0.5, 0.5, 0.5]))
    assert met.tolist() == [True, True, True, False, False]
    assert np.isnan(x[3:]).all()
    np.testing.assert_allclose((lines[:3] * np.column_stack([x[:3], np.ones(3)])).sum(axis=1), 0, atol=1e-9)
    assert x[0, 1] in (0.0, 79.0)
    assert x[1, 0] == pytest.approx(49.5)
    np.testing.assert_allclose(x[2], [5, 5])


def test_pose_of_the_true_matrix_is_exact_and_of_others_off_by_what_they_are():
    pair = two_cameras()
    points = points_before(pair)
    for F in (pair_F := fundamental_from_cameras(*pair), -pair_F):
        assert max(pose_errors(F, pair, *points)) < 1e-5
    turned = two_cameras(angle=21.0)
    rotation_deg, _ = pose_errors(fundamental_from_cameras(*turned), pair, *points_before(turned))
    assert rotation_deg == pytest.approx(6.0, abs=1e-4)
    t, moved = np.array([-2.0, 0.3, 0.4]), np.array([-2.0, 1.3, 0.4])
    other = two_cameras(t=moved)
    _, translation_deg = pose_errors(fundamental_from_cameras(*other), pair, *points_before(other))
    cosine = t @ moved / np.linalg.norm(t) / np.linalg.norm(moved)
    assert translation_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-4)
    F = normalise_fundamental(np.array([[0, -1, 0.1], [1, 0, 0.2], [0.3, 0.1, 0]]))
    assert np.isnan(pose_errors(F, two_cameras(t=(0.0, 0.0, 0.0)), *points)[1])  # no baseline, no translation
