"""Labels, control points and the true F, on a small world whose depth is known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

from epiprior.errors import FeatureError
from epiprior.geometry import sampson_distance
from epiprior_lab import pairsets
from epiprior_lab.labels import ground_truth
from epiprior_lab.labels.ground_truth import TRUTH, label_matches, reference_fundamental
from epiprior_lab.pairsets import DatasetError, depth_at, encode_depth, read_pair_set, reproject, view_difference
from epiprior_lab.scenes.render import render_depth
from epiprior_lab.stages import ground_truth as stage
from epiprior_lab.stages import render as render_stage
from worlds import HEIGHT, WIDTH, camera_at, camera_pair, room

CAMERAS = camera_at(-2.5), camera_at(2.5, roll_deg=15.0)


@pytest.fixture(scope="module")
def depths():
    world = room()
    return tuple(render_depth(world, camera) for camera in CAMERAS)


@pytest.fixture
def pair(tmp_path, depths):
    paths = (tmp_path / "1.npz", tmp_path / "2.npz")
    for path, depth in zip(paths, depths, strict=True):
        path.write_bytes(encode_depth(depth))
    return camera_pair(tmp_path, CAMERAS, depth_paths=paths)


@pytest.fixture(scope="module")
def points(depths):
    return ground_truth.control_points_from_depth(CAMERAS, depths, count=200, seed=1)


def label(pair, x1, x2, sigma=2.0, **settings):
    scale = np.full(len(x1), sigma)
    return label_matches(pair, x1, x2, scale, scale, settings=dataclasses.replace(TRUTH, **settings))


def test_true_matches_are_right_and_moved_ones_wrong_but_for_large_features(pair, points):
    x1, x2 = points
    assert label(pair, x1, x2).all()
    for shift in ([6.0, 0.0], [0.0, -6.0]):
        assert not label(pair, x1, x2 + shift).any()
        assert not label(pair, x1 + shift, x2).any()
    assert label(pair, x1, x2 + [0.5, 0.0]).mean() > 0.97
    farther, _ = reproject(*CAMERAS, x1, 1.3 * depth_at(pair.depths()[0], x1))
    far_off = np.linalg.norm(farther - x2, axis=1) > 5
    assert far_off.sum() > 100
    assert sampson_distance(reference_fundamental(pair), x1, farther).max() < 1e-6
    assert not label(pair, x1[far_off], farther[far_off]).any()
    moved = x2 + [4.0, 0.0]
    assert not label(pair, x1, moved, sigma=2.0).any()
    assert label(pair, x1, moved, sigma=20.0).mean() > 0.9
    assert label(pair, x1, moved, sigma=2.0, tolerance_px=10.0).mean() > 0.9


def test_what_the_other_camera_cannot_see_is_wrong_but_a_feature_beside_the_rim_of_its_object_right(pair, depths):
    y, x = np.mgrid[5:HEIGHT:5, 5:WIDTH:5]
    x1 = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    depth = depth_at(depths[0], x1)
    x1, depth = x1[np.isfinite(depth)], depth[np.isfinite(depth)]
    x2, depth2 = reproject(*CAMERAS, x1, depth)
    hidden = depth_at(depths[1], x2) < 0.8 * depth2
    assert hidden.sum() > 20
    assert label(pair, x1[hidden], x2[hidden]).mean() < 0.1  # at the rim of what hides it, one may pass
    row, column = np.argwhere(np.isinf(depths[0]))[0]
    x = np.array([[column, row], [-50.0, 3.0], [WIDTH + 40.0, 9.0]], dtype=np.float64)
    assert not label(pair, x, x).any()
    assert label(pair, x[:0], x[:0]).shape == (0,)
    with pytest.raises(FeatureError, match="x2"):
        label(pair, x, x * np.nan)
    over = np.isfinite(depths[0][:-1]) & (1.2 * depths[0][1:] < depths[0][:-1])  # wall above the top of the box
    row, column = np.argwhere(over)[10]
    beside, on_box = np.array([[column, row]], dtype=float), np.array([[column, row + 1]], dtype=float)
    meant, _ = reproject(*CAMERAS, beside, depth_at(depths[0], on_box))
    assert np.linalg.norm(meant - reproject(*CAMERAS, beside, depth_at(depths[0], beside))[0]) > 10
    assert label(pair, beside, meant).all()
    assert not label(pair, beside - [0.0, 6.0], meant - [0.0, 6.0]).any()


def test_without_depth_the_epipolar_line_decides_and_control_points_alone_give_nearly_the_f_of_the_cameras(
    pair, points, tmp_path
):
    x1, x2 = points
    without = dataclasses.replace(pair, depth_paths=None)
    assert label(without, x1, x2).all()
    F = reference_fundamental(without)
    moved = x2 + [0.0, 5.0]
    np.testing.assert_array_equal(label(without, x1, moved), sampson_distance(F, x1, moved) < 2.0)
    assert (~label(without, x1, moved)).mean() > 0.5
    rng, path = np.random.default_rng(0), tmp_path / "p.csv"
    only = dataclasses.replace(pair, camera1=None, camera2=None, depth_paths=None, control_points_path=path)
    pairsets.write_control_points(path, *(x + rng.normal(0, 0.3, x.shape) for x in points))
    assert sampson_distance(reference_fundamental(only), *points).mean() < 0.3
    assert label(only, *points).mean() > 0.98
    pairsets.write_control_points(path, points[0][:7], points[1][:7])
    with pytest.raises(DatasetError, match=r"'p'.* no fundamental matrix"):
        label(only, *points)
    same = dataclasses.replace(pair, camera2=pair.camera1, depth_paths=None)  # one centre decides nothing
    with pytest.raises(DatasetError, match="no fundamental matrix"):
        reference_fundamental(same)


def test_control_points_cover_the_whole_overlap_and_depend_on_the_seed_alone(depths, points):
    x1, _ = points
    assert len(x1) == len(np.unique(x1, axis=0)) == 200
    dense, _ = ground_truth.control_points_from_depth(CAMERAS, depths, count=20_000, seed=0)
    for k in range(2):  # every tenth of the overlap's extent holds some
        counts, _ = np.histogram(x1[:, k], np.quantile(dense[:, k], np.linspace(0, 1, 11)))
        assert counts.min() > 8, counts
    first, again, other = (ground_truth.control_points_from_depth(CAMERAS, depths, count=50, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(first[1], again[1])
    assert not np.array_equal(first[0], other[0])
    nothing = (depths[0], np.full_like(depths[0], np.inf))
    assert [len(x) for x in ground_truth.control_points_from_depth(CAMERAS, nothing, count=50, seed=0)] == [0, 0]


def test_depth_between_pixels_is_exact_on_a_plane_and_unmixed_at_a_rim():
    y, x = np.mgrid[:20, :30]
    depth = (1.0 / (0.1 + 0.002 * x + 0.004 * y)).astype(np.float32)
    at = np.random.default_rng(0).uniform(0, (29, 19), (50, 2))
    np.testing.assert_allclose(depth_at(depth, at), 1 / (0.1 + at @ [0.002, 0.004]), rtol=1e-5)
    depth[:, 15:] *= 3
    assert depth_at(depth, np.array([[14.4, 5.0]]))[0] == depth[5, 14]
    assert depth_at(depth, np.array([[14.6, 5.0]]))[0] == depth[5, 15]
    assert np.isinf(depth_at(depth, np.array([[-0.6, 5.0], [29.6, 5.0], [5.0, 1e300], [np.nan, 5.0]]))).all()


def test_differences_of_views_are_measured(depths):
    seen = view_difference(CAMERAS, depths)
    assert seen.roll_deg == pytest.approx(15, abs=3)
    assert 15 < seen.angle_deg < 60
    assert 0.3 < seen.overlap < 1 <= seen.scale_ratio < 1.5
    same = view_difference((CAMERAS[0],) * 2, (depths[0],) * 2)
    assert (same.angle_deg, same.roll_deg) == pytest.approx((0, 0), abs=1e-5)
    assert (same.overlap, same.scale_ratio) == pytest.approx((1, 1))
    nothing = view_difference(CAMERAS, (depths[0], np.full_like(depths[1], np.inf)))
    assert nothing.overlap == 0
    assert np.isnan(nothing.angle_deg)
    cameras = camera_at(0.0, z=-12.0), camera_at(0.0, z=-24.0)  # twice as far is half as large
    seen = view_difference(cameras, tuple(render_depth(room(), camera) for camera in cameras))
    assert 1.5 < seen.scale_ratio < 2.5


@pytest.mark.slow
def test_the_stages_write_pair_sets_with_control_points(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EPIPRIOR_WORKERS", "1")
    params = yaml.safe_load((Path(__file__).parents[3] / "params.yaml").read_text(encoding="utf-8"))
    families = params["scenes"]["families"]
    params["scenes"]["pairs"]["validation"] = dict.fromkeys(families, 1)
    params["scenes"] |= {"image_width": 160, "image_height": 120}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    monkeypatch.setattr("sys.argv", ["stage", "--split", "validation"])
    render_stage.main()
    stage.main()
    scenes = set()
    for family in families:
        truth = tmp_path / "data" / "ground_truth" / "validation" / family
        pair_set = read_pair_set(tmp_path / "data" / "scenes" / "validation" / family, truth / "control_points")
        (pair,) = pair_set.pairs
        assert pair.pair_id == f"{family}-validation-0000"
        scenes.add(pair.scene)
        x1, x2 = pair.control_points()
        assert len(x1) == 100
        assert sampson_distance(pair.fundamental(), x1, x2).max() < 1e-3
        assert label(pair, x1, x2).mean() > 0.97  # files are rounded, and a rim at 160 px is steep
        header, row = (truth / "summary.csv").read_text().splitlines()
        assert header.startswith("pair_id,scene,angle_deg,overlap,scale_ratio,roll_deg,control_points")
        assert row.startswith(f"{pair.pair_id},")
        assert row.endswith(",100")
    assert len(scenes) == len(families) == 4
