"""Plausibility of F against singular values, on cameras of many kinds; the cells that inliers cover."""

import numpy as np
import pytest

from epiprior.geometry import eight_point
from epiprior.verification.measures import FOCAL_LENGTHS, camera_plausibility, spread_groups
from synthetic import rotation, skew

SIZES = ((1024, 768), (1024, 768))


def fundamental(f1, f2, seed=0):
    rng = np.random.default_rng(seed)
    R, t = rotation(tuple(rng.normal(size=3)), 25.0), rng.normal(size=3)
    K1, K2 = (np.array([[f, 0, 511.5], [0, f, 383.5], [0, 0, 1.0]]) for f in (f1, f2))
    F = np.linalg.inv(K2).T @ skew(t) @ R @ np.linalg.inv(K1)
    return F / np.linalg.norm(F)


def naive_plausibility(F, sizes):
    best = 0.0
    for focal in FOCAL_LENGTHS:
        of_sizes = [(focal * max(width, height), (width - 1) / 2, (height - 1) / 2) for width, height in sizes]
        K = [np.array([[f, 0, x], [0, f, y], [0, 0, 1]]) for f, x, y in of_sizes]
        s = np.linalg.svd(K[1].T @ F @ K[0], compute_uv=False)
        best = max(best, s[1] / s[0])
    return best


@pytest.mark.parametrize("sizes", [SIZES, ((1024, 768), (600, 800))])
def test_equals_singular_values(sizes):
    pixels = np.array([[1e6, 1e6, 1e3], [1e6, 1e6, 1e3], [1e3, 1e3, 1]])
    U, s, Vt = np.linalg.svd(np.random.default_rng(0).normal(size=(20, 3, 3)) / pixels)
    s[:, 2] = 0
    models = (U * s[:, None]) @ Vt
    wanted = [naive_plausibility(F, sizes) for F in models]
    np.testing.assert_allclose(camera_plausibility(models, sizes), wanted, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("focal", [0.7, 1.0, 1.6, 2.4])
def test_photographs_are_plausible_at_any_usual_focal_length(focal, seed):
    f = focal * 1024
    assert camera_plausibility(fundamental(f, f, seed=seed)[None], SIZES)[0] > 0.93
    assert camera_plausibility(fundamental(f, 1.03 * f, seed=seed)[None], SIZES)[0] > 0.85


def test_scale_and_size_of_the_pixels_change_nothing_outliers_make_implausible_cameras_without_sizes_nothing_is_known():
    F = fundamental(900.0, 1100.0)
    half = np.diag([2.0, 2.0, 1.0])
    half[:2, 2] = 0.5  # pixel centres: (x + 0.5) / 2 - 0.5
    small = tuple((w / 2, h / 2) for w, h in SIZES)
    value = camera_plausibility(F[None], SIZES)
    assert camera_plausibility(-7 * F[None], SIZES) == pytest.approx(value)
    assert camera_plausibility((half.T @ F @ half)[None], small) == pytest.approx(value, rel=1e-9)
    rng = np.random.default_rng(1)
    x1, x2 = (rng.uniform(0, [1024, 768], (200, 8, 2)) for _ in range(2))
    models = np.array([F for a, b in zip(x1, x2, strict=True) if (F := eight_point(a, b)) is not None])
    assert np.median(camera_plausibility(models, SIZES)) < 0.9
    assert (camera_plausibility(models, SIZES) <= 1).all()
    models = np.random.default_rng(0).normal(size=(3, 3, 3))
    assert (camera_plausibility(models, None) == 1).all()
    assert camera_plausibility(np.empty((0, 3, 3)), SIZES).shape == (0,)
    assert camera_plausibility(np.zeros((1, 3, 3)), SIZES) == [0.0]
    assert camera_plausibility(1e-160 * models, SIZES).shape == (3,)  # squares that underflow are no error


def test_groups_are_parts_of_both_images():
    x1 = np.array([[10.0, 10.0], [40.0, 40.0], [10.0, 10.0], [60.0, 10.0]])
    x2 = np.array([[10.0, 10.0], [20.0, 30.0], [100.0, 10.0], [10.0, 10.0]])
    a, b, c, d = spread_groups(x1, x2)
    assert a == b
    assert len({a, c, d}) == 3
    assert spread_groups(x1[:0], x2[:0]).shape == (0,)
