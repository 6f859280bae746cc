"""An F under known intrinsics: where it is better than one without, and that nothing else changes."""

from dataclasses import fields, replace

import numpy as np
import pytest

from epiprior.estimators import essential
from epiprior.estimators.essential import Intrinsics, essential_matrices
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from synthetic import HEIGHT, WIDTH, K, make_pair

pycolmap = pytest.importorskip("pycolmap")
SIZES = (WIDTH, HEIGHT), (WIDTH, HEIGHT)
KNOWN = Intrinsics(K=K)


def estimate(matches, intrinsics=(KNOWN, KNOWN), **how):
    sets = [replace(matches, image_sizes=SIZES)]
    return estimate_from_matches(
        sets, estimator="epiprior", hand_over=HandOver(collect=True), intrinsics=intrinsics, **how
    )


def test_essential_matrices_are_those_of_exact_matches():
    pair = make_pair(inliers=80, outliers=40, noise_px=0.0)
    found = list(essential_matrices(pair.matches.x1, pair.matches.x2, K, K, threshold_px=1.5, seed=0))
    assert len(found) == 2
    for E, F in found:
        np.testing.assert_allclose(np.linalg.svd(E)[1] / np.linalg.norm(E), [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)
        assert pair.error_px(F) < 0.01


def test_known_intrinsics_decide_what_one_plane_leaves_open():
    pair = make_pair(scene="plane+", inliers=120, outliers=60, off_plane=10, noise_px=0.7, seed=3)
    plain = estimate(pair.matches)
    found = plain.calibrated
    assert pair.error_px(found.F) < 0.5 * pair.error_px(plain.F)
    assert found.E is not None
    np.testing.assert_array_equal(found.x1, plain.x1)
    assert found.support == found.inliers.sum() > 100


def test_the_rest_of_an_estimate_is_as_without_and_transposes():
    pair = make_pair(noise_px=0.5)
    plain, known = estimate(pair.matches, None), estimate(pair.matches)
    assert known.calibrated.confidence > 0.9
    for field in fields(plain):
        if field.name not in ("seconds", "calibrated"):
            np.testing.assert_array_equal(getattr(plain, field.name), getattr(known, field.name))
    other = Intrinsics(K=np.diag([0.5, 0.5, 1]) @ K)
    large = replace(pair.matches, x2=pair.matches.x2 / 2)
    for least in (None, 1.0):  # sure, and not
        how = {"min_confidence": least, "pixel_factors": (1.0, 0.5)}
        there = estimate(large, (KNOWN, other), **how).calibrated
        back = estimate(large.swapped(), (other, KNOWN), **how | {"pixel_factors": (0.5, 1.0)}).calibrated.swapped()
        for name in ("F", "E", "x1", "x2"):
            np.testing.assert_array_equal(getattr(there, name), getattr(back, name))
    np.testing.assert_allclose(there.E, known.calibrated.E, atol=1e-6)
    assert there.swapped().swapped().E is not None


def test_wrong_focal_lengths_cost_support():
    pair = make_pair(noise_px=0.3)
    wrong = [Intrinsics(K=np.diag([factor, factor, 1]) @ K) for factor in (4.0, 0.25)]
    found = estimate(pair.matches, tuple(wrong))
    assert found.calibrated.support < 0.7 * found.support
    assert found.calibrated.confidence < found.confidence


def test_distortion_is_taken_out_of_the_points():
    pair = make_pair(noise_px=0.3)
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", K[0, 0], WIDTH, HEIGHT)
    camera.params = [K[0, 0], K[0, 2], K[1, 2], 0.4]

    def distort(x):
        rays = np.column_stack([(x - K[:2, 2]) / K[0, 0], np.ones(len(x))])
        return camera.img_from_cam(rays)

    def undistort(x):
        return camera.cam_from_img(x) * K[0, 0] + K[:2, 2]

    bent = replace(pair.matches, x1=distort(pair.matches.x1), x2=distort(pair.matches.x2))
    lens = Intrinsics(K=K, undistort=undistort)
    found = estimate(bent, (lens, lens)).calibrated
    assert pair.error_px(found.F) < 0.5
    assert found.support > estimate(bent).calibrated.support
    np.testing.assert_array_equal(found.x1, estimate(bent).x1)


def test_no_essential_matrix_is_looked_for_where_f_has_no_chance(monkeypatch):
    monkeypatch.setattr(essential, "require", None)
    assert estimate(make_pair(inliers=10, outliers=300, order=0.0).matches).calibrated is None
