"""COLMAP databases: what is written is mapped by pycolmap; what COLMAP has filled is extended."""

import sqlite3

import numpy as np
import pytest

from collections_fakes import MATCHES, FakeEstimation, in_this_process, rows_of, small_images
from epiprior import FeatureError, ImageError, OutputError, SettingsError, Status, match_collection
from epiprior.collection.database import CameraSettings, extend_database, infer_cameras, read_filled, write_database
from epiprior.collection.images import find_images
from epiprior.collection.verify import judge_pairs
from epiprior.geometry import sampson_distance
from feature_files import extract_colmap
from pictures import save, texture

pycolmap = pytest.importorskip("pycolmap")


@pytest.fixture
def found(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set", ("a.png", "sub/b.png", "sub/c.png"))
    return match_collection(tmp_path / "set")


def test_database_holds_what_was_matched_and_no_pair_without_geometry(tmp_path, found, monkeypatch):
    path, cameras = tmp_path / "scene.db", infer_cameras(found.images, CameraSettings())
    assert write_database(path, judge_pairs(found, 0.5), cameras) == 3
    with pycolmap.Database.open(path) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        assert database.num_cameras() == database.num_rigs() == database.num_frames() == 3
        for pair in found:
            both = ids[pair.image1], ids[pair.image2]
            geometry = database.read_two_view_geometry(*both)
            assert geometry.config == pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED.value
            np.testing.assert_array_equal(geometry.inlier_matches, pair.matches)
            np.testing.assert_array_equal(database.read_matches(*both), pair.matches)
            x1, x2 = (
                database.read_keypoints(i)[column].astype(float) for i, column in zip(both, pair.matches.T, strict=True)
            )
            own = [found.features(k).xy for k in (list(ids).index(pair.image1), list(ids).index(pair.image2))]
            expected = sampson_distance(pair.F, own[0][pair.matches[:, 0]], own[1][pair.matches[:, 1]])
            np.testing.assert_allclose(sampson_distance(geometry.F, x1, x2), expected, rtol=1e-3, atol=1e-3)
    with pytest.raises(OutputError, match="exists already"):
        write_database(path, judge_pairs(found, 0.5), cameras)
    assert write_database(tmp_path / "high.db", judge_pairs(found, 1.1), cameras) == 0
    in_this_process(monkeypatch, FakeEstimation(Status.NO_MODEL))
    found = match_collection(tmp_path / "set")
    assert write_database(tmp_path / "none.db", judge_pairs(found, 0.0), cameras) == 0
    assert not any(rows_of(tmp_path / "none.db", "matches", "two_view_geometries").values())


def test_a_database_that_was_made_meanwhile_stays(tmp_path, found, monkeypatch):
    path, cameras = tmp_path / "scene.db", infer_cameras(found.images, CameraSettings())
    add = pycolmap.Database.write_two_view_geometry
    monkeypatch.setattr(pycolmap.Database, "write_two_view_geometry", lambda *a: path.write_text("mine") and add(*a))
    with pytest.raises(OutputError, match="exists already"):
        write_database(path, judge_pairs(found, 0.5), cameras)
    assert path.read_text() == "mine"
    assert not list(tmp_path.glob(".scene*"))


@pytest.mark.parametrize(("mode", "count"), [("single", 1), ("per-folder", 2), ("per-image", 3)])
def test_cameras_are_shared(tmp_path, found, mode, count):
    cameras = infer_cameras(found.images, CameraSettings(mode=mode, model="PINHOLE", params="300,310,100,75"))
    write_database(tmp_path / "scene.db", judge_pairs(found, 0.5), cameras)
    with pycolmap.Database.open(tmp_path / "scene.db") as database:
        known = database.read_all_cameras()
        assert len(known) == count
        assert len({image.camera_id for image in database.read_all_images()}) == count
        assert all(camera.params.tolist() == [300, 310, 100, 75] for camera in known)
        assert all(camera.has_prior_focal_length for camera in known)
    # COLMAP's guess: 1.2 times the longer side.
    assert infer_cameras(found.images, CameraSettings(mode=mode))[0][1].focal_length == pytest.approx(240)


def test_cameras_that_cannot_be(tmp_path):
    small_images(tmp_path)
    save(tmp_path / "d.png", texture(210, 150, 9))
    images = find_images(tmp_path)
    for error, words, settings in (
        (ImageError, r"d\.png: is 210 x 150, a\.png, of the same camera, 200 x 150", {"mode": "single"}),
        (SettingsError, "camera model 'LENS', known: .*SIMPLE_RADIAL", {"model": "LENS"}),
        (SettingsError, "camera parameters '1,2': SIMPLE_RADIAL has f, cx, cy, k", {"params": "1,2"}),
    ):
        with pytest.raises(error, match=words):
            infer_cameras(images, CameraSettings(**settings))


@pytest.fixture
def filled(tmp_path):
    """A database as COLMAP leaves it after the extraction of features."""
    small_images(tmp_path / "set", ("a.png", "sub/b.png", "sub/c.png"))
    return extract_colmap(tmp_path / "colmap.db", tmp_path / "set")


@pytest.mark.parametrize("with_photographs", [True, False])
def test_a_database_of_colmap_is_extended(tmp_path, filled, monkeypatch, with_photographs):
    estimation = in_this_process(monkeypatch)
    mine = ("cameras", "images", "keypoints", "descriptors")
    with pycolmap.Database.open(filled) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        keypoints = {name: database.read_keypoints(i) for name, i in ids.items()}
        geometry = pycolmap.TwoViewGeometry()
        geometry.config, geometry.inlier_matches = 2, np.array([[0, 0]], np.uint32)
        database.write_two_view_geometry(ids["sub/c.png"], ids["a.png"], geometry)
        database.write_matches(ids["a.png"], ids["sub/b.png"], np.empty((0, 2), np.uint32))  # COLMAP found none
    before = rows_of(filled, *mine)
    known = read_filled(filled, tmp_path / "set" if with_photographs else None)
    found = match_collection(known.images, given=known.features, without=known.verified)
    assert [(pair.image1, pair.image2) for pair in found] == [("a.png", "sub/b.png"), ("sub/b.png", "sub/c.png")]
    assert extend_database(filled, judge_pairs(found, 0.5)) == 2
    assert rows_of(filled, *mine) == before
    assert all((call["views"][0] is not None) == with_photographs for call in estimation.calls)
    with pycolmap.Database.open(filled) as database:
        assert database.num_verified_image_pairs() == 3
        for pair in found:
            got = database.read_matches(ids[pair.image1], ids[pair.image2])
            np.testing.assert_array_equal(got, pair.matches)
            assert len(got) == MATCHES
    for name, place in zip(("a.png", "sub/b.png", "sub/c.png"), range(3), strict=True):
        np.testing.assert_allclose(found.features(place).xy + 0.5, keypoints[name][:, :2], atol=1e-4)


def test_an_extension_that_failed_goes_on(tmp_path, filled, monkeypatch):
    in_this_process(monkeypatch)
    known = read_filled(filled, tmp_path / "set")
    found = match_collection(known.images, given=known.features)
    write, count = pycolmap.Database.write_two_view_geometry, []

    def full(*args):
        count.append(args)
        if len(count) == 2:
            raise RuntimeError("database or disk is full")
        write(*args)

    monkeypatch.setattr(pycolmap.Database, "write_two_view_geometry", full)
    with pytest.raises(OutputError, match=r"colmap\.db.*disk is full"):
        extend_database(filled, judge_pairs(found, 0.5))
    monkeypatch.setattr(pycolmap.Database, "write_two_view_geometry", write)
    known = read_filled(filled, tmp_path / "set")
    assert known.verified == {("a.png", "sub/b.png")}
    rest = match_collection(known.images, given=known.features, without=known.verified)
    assert extend_database(filled, judge_pairs(rest, 0.5)) == 2
    assert len(read_filled(filled, None).verified) == 3


def test_databases_that_cannot_be_extended(tmp_path, filled):
    (tmp_path / "text.db").write_text("no database at all, but long enough to be read as one")
    with pytest.raises(FeatureError, match=r"text\.db: exists already, and is no COLMAP database"):
        read_filled(tmp_path / "text.db", None)
    with pytest.raises(ImageError, match=r"a\.png: no such image file"):
        read_filled(filled, tmp_path)
    with sqlite3.connect(filled) as opened:
        opened.execute("DELETE FROM descriptors")
    with pytest.raises(FeatureError, match=r"a\.png has no descriptors"):
        read_filled(filled, tmp_path / "set")
