"""Features of COLMAP databases and hloc's h5 files: what was written is read back; what cannot be read says why."""

import contextlib
import sqlite3
import sys

import numpy as np
import pycolmap
import pytest

from calls import refused
from epiprior import FeatureError, Features, rank_matches
from epiprior.features.describe import normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.io import read_colmap_features, read_hloc_features
from epiprior.presets import FeatureSettings
from feature_files import hloc_parts, signed, write_h5
from pictures import relief_pair

SIZE = (640, 480)
SIFT, ALIKED = pycolmap.FeatureExtractorType.SIFT, pycolmap.FeatureExtractorType.ALIKED_N32


def make_features(n=7, seed=0):
    rng = np.random.default_rng(seed)
    xy, scale, angle = rng.uniform(0, 400, (n, 2)), rng.uniform(1, 9, n), rng.uniform(0, 360, n)
    descriptors = rng.integers(0, 256, (n, 128)).astype(np.float32)
    return Features(xy=xy, scale=scale, orientation_deg=angle, descriptors=descriptors, image_size=SIZE)


def colmap_rows(features):
    """Return x, y, scale, orientation as COLMAP counts them."""
    return np.column_stack([features.xy + 0.5, features.scale, np.deg2rad(signed(features))]).astype(np.float32)


def affine_rows(rows):
    """Return x, y, a11, a12, a21, a22, with COLMAP's own arithmetic."""
    frames = pycolmap.keypoints_from_matrix(np.ascontiguousarray(rows))
    return np.array([[k.x, k.y, k.a11, k.a12, k.a21, k.a22] for k in frames], np.float32)


def write_database(path, images):
    """Write images, each name with its size, rows of keypoints or None, and descriptors of pycolmap or None."""
    database = pycolmap.Database.open(path)
    for name, (size, rows, descriptors) in images.items():
        camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.SIMPLE_PINHOLE, 500, *size)
        image_id = database.write_image(pycolmap.Image(name=name, camera_id=database.write_camera(camera)))
        if rows is not None:
            database.write_keypoints(image_id, rows)
        if descriptors is not None:
            database.write_descriptors(image_id, descriptors)
    database.close()
    return path


def described(descriptors, kind=SIFT):
    return pycolmap.FeatureDescriptors(kind, np.ascontiguousarray(descriptors, np.uint8))


def assert_frames(read, written, rtol=1e-5):
    np.testing.assert_allclose(read.xy, written.xy, rtol=rtol, atol=1e-4)
    np.testing.assert_allclose(read.scale, written.scale, rtol=rtol)
    np.testing.assert_allclose(read.orientation_deg, written.orientation_deg, rtol=rtol, atol=1e-4)
    assert read.image_size == written.image_size


# --- COLMAP


@pytest.mark.parametrize("make_rows", [colmap_rows, lambda f: affine_rows(colmap_rows(f))], ids=["4", "6"])
def test_colmap_database_is_read_back(tmp_path, make_rows):
    written, other = make_features(), make_features(n=3, seed=1)
    images = {
        "other.jpg": ((300, 200), colmap_rows(other), described(other.descriptors)),
        "left/1.jpg": (SIZE, make_rows(written), described(written.descriptors)),
    }
    path = write_database(tmp_path / "a database?.db", images)
    read = read_colmap_features(str(path), "left/1.jpg")
    assert_frames(read, written)
    np.testing.assert_array_equal(read.descriptors, written.descriptors**2)
    np.testing.assert_array_equal(read_colmap_features(path, "left/1.jpg", roots=0).descriptors, written.descriptors)
    assert read_colmap_features(path, "other.jpg").image_size == (300, 200)


def test_affine_frames_are_as_colmap_computes_and_without_texture_there_are_none(tmp_path):
    frame = pycolmap.FeatureKeypoint.from_shape_parameters(5, 6, 2, 3, 0.5, 0.2)
    row = np.array([[frame.x, frame.y, frame.a11, frame.a12, frame.a21, frame.a22]], np.float32)
    path = write_database(tmp_path / "a.db", {"a.jpg": (SIZE, row, described(np.ones((1, 128))))})
    read = read_colmap_features(path, "a.jpg")
    np.testing.assert_allclose(read.xy, [[4.5, 5.5]])
    np.testing.assert_allclose(read.scale, frame.compute_scale(), rtol=1e-6)
    np.testing.assert_allclose(read.orientation_deg, np.rad2deg(frame.compute_orientation()), rtol=1e-6)
    empty = (SIZE, np.empty((0, 4), np.float32), described(np.empty((0, 128))))
    read = read_colmap_features(write_database(tmp_path / "b.db", {"a.jpg": empty}), "a.jpg")
    assert (len(read), read.descriptors.shape) == (0, (0, 128))


def extracted(grey):
    """Return the rows and the descriptors that COLMAP's feature extraction stores."""
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract(pycolmap.Bitmap.from_array(grey))
    return pycolmap.keypoints_to_matrix(keypoints), descriptors


def test_features_of_colmap_are_those_of_the_detector_and_are_ranked(tmp_path):
    pictures = relief_pair()
    images = {f"{k}.png": (pictures[0].shape[::-1], *extracted(grey)) for k, grey in enumerate(pictures)}
    path = write_database(tmp_path / "a.db", images)
    first, second = (read_colmap_features(path, name) for name in images)
    settings = FeatureSettings(detector="colmap-sift", max_keypoints=8192, contrast_threshold=0.02)
    detected = detect_features(load_photograph(pictures[0]), settings)
    assert len(first) == len(detected) > 100
    assert_frames(first, detected)
    np.testing.assert_array_equal(first.descriptors, detected.descriptors)
    ranked = rank_matches(None, None, features1=first, features2=second)
    assert len(ranked.sets[0]) > 100
    assert np.median(ranked.sets[0].probability[:50]) > 0.5


@pytest.mark.parametrize(
    ("image", "message"),
    [
        ((SIZE, None, None), "no keypoints or no descriptors"),
        ((SIZE, np.ones((2, 4), np.float32), None), "no keypoints or no descriptors"),
        ((SIZE, np.ones((2, 2), np.float32), described(np.ones((2, 128)))), "2 columns.*scale and the orientation"),
        ((SIZE, np.ones((3, 4), np.float32), described(np.ones((2, 128)))), "descriptors has shape"),
        ((SIZE, np.zeros((2, 4), np.float32), described(np.ones((2, 128)))), "scale must be positive"),
        ((SIZE, np.ones((2, 4), np.float32), described(np.ones((2, 512)), ALIKED)), "described by ALIKED_N32"),
    ],
)
def test_image_that_cannot_be_used_says_why(tmp_path, image, message):
    path = write_database(tmp_path / "bad.db", {"a.jpg": image})
    refused(FeatureError, rf"bad\.db: image 'a\.jpg'.*{message}", read_colmap_features, path, "a.jpg")


def test_database_that_cannot_be_read_says_why(tmp_path):
    path = write_database(tmp_path / "good.db", {f"{k}.jpg": (SIZE, None, None) for k in range(3)})
    image = (SIZE, np.ones((2, 4), np.float32), described(np.ones((2, 128))))
    other = write_database(tmp_path / "b.db", {"x.jpg": image})
    text, foreign = tmp_path / "text.db", tmp_path / "other.db"
    text.write_text("no database\n" * 100, encoding="utf-8")
    with contextlib.closing(sqlite3.connect(foreign)) as connection, connection:
        connection.execute("CREATE TABLE images (name TEXT)")
    before = foreign.read_bytes()
    absent, tables = r"good\.db: has no image 'x\.jpg' among its 3 images", "no table cameras, descriptors, keypoints"
    refused(FeatureError, absent, read_colmap_features, path, "x.jpg")
    refused(FeatureError, "roots is -1", read_colmap_features, other, "x.jpg", roots=-1)
    refused(FeatureError, r"missing\.db: no such file", read_colmap_features, tmp_path / "missing.db", "x.jpg")
    refused(FeatureError, "is a folder", read_colmap_features, tmp_path, "x.jpg")
    none = r"text\.db: not a COLMAP database: file is not a database"
    refused(FeatureError, none, read_colmap_features, text, "x.jpg")
    refused(FeatureError, rf"other\.db: .*{tables}", read_colmap_features, foreign, "x.jpg")
    assert not (tmp_path / "missing.db").exists()
    assert foreign.read_bytes() == before


# --- hloc


def test_h5_is_read_back(tmp_path):
    written = make_features()
    images = {"db/1.jpg": hloc_parts(written), "db/2.jpg": hloc_parts(make_features(3, seed=1))}
    path = write_h5(tmp_path / "a.h5", images)
    read = read_hloc_features(str(path), "db/1.jpg", roots=0)
    assert_frames(read, written)
    np.testing.assert_array_equal(read.descriptors, written.descriptors)
    assert len(read_hloc_features(path, "db/2.jpg")) == 3
    halved = read_hloc_features(write_h5(tmp_path / "b.h5", {"a": hloc_parts(written, np.float16)}), "a", roots=0)
    assert_frames(halved, written, rtol=1e-3)


def hloc_rootsift(descriptors):
    """Return the root of descriptors as hloc's extractor takes it."""
    rooted = np.sqrt(np.maximum(descriptors / (np.abs(descriptors).sum(axis=1, keepdims=True) + 1e-6), 1e-6))
    return rooted / (np.linalg.norm(rooted, axis=1, keepdims=True) + 1e-6)


@pytest.mark.parametrize("root", [True, False])
def test_the_roots_of_hloc_are_undone(tmp_path, root):
    plain = make_features(n=20).descriptors
    # COLMAP takes the first root, hloc the second.
    parts = hloc_parts(make_features(n=20)) | {"descriptors": hloc_rootsift(hloc_rootsift(plain)).T.astype(np.float16)}
    read = read_hloc_features(write_h5(tmp_path / "a.h5", {"a": parts}), "a")
    expected = normalise_descriptors(plain, root=root, centred=True)
    got = normalise_descriptors(read.descriptors, root=root, centred=True)
    assert np.einsum("ij,ij->i", got, expected).min() > 0.9999


def test_h5_that_cannot_be_used_says_why(tmp_path):
    parts = hloc_parts(make_features())
    path = write_h5(tmp_path / "a.h5", {"db/1.jpg": parts, "db/2.jpg": parts})
    for name in ("3.jpg", "db/1.jpg/keypoints"):
        refused(FeatureError, rf"a\.h5: has no image '{name}' among its 2 images", read_hloc_features, path, name)
    for dropped, message in (
        (["scales"], "no scales: epiprior needs the scale and the orientation"),
        (["keypoints"], "no keypoints"),
        (["descriptors", "scales"], "no descriptors, scales"),
        (["image_size"], "no image_size"),
    ):
        rest = {key: value for key, value in parts.items() if key not in dropped}
        with pytest.raises(FeatureError, match=rf"c\.h5: image 'a' has {message}"):
            read_hloc_features(write_h5(tmp_path / "c.h5", {"a": rest}), "a")
    learned = parts | {"descriptors": -parts["descriptors"]}
    swapped, text = parts | {"descriptors": parts["descriptors"].T}, parts | {"oris": ["north"] * 7}
    path = write_h5(tmp_path / "b.h5", {"a": learned, "b": swapped, "c": text})
    np.testing.assert_array_equal(read_hloc_features(path, "a", roots=0).descriptors, learned["descriptors"].T)
    (tmp_path / "text.h5").write_text("no h5\n", encoding="utf-8")
    refused(FeatureError, "b.h5: image 'a' has negative descriptor entries", read_hloc_features, path, "a")
    refused(FeatureError, "b.h5: image 'b': features: descriptors has shape", read_hloc_features, path, "b")
    refused(FeatureError, "b.h5: image 'c': oris is of type object", read_hloc_features, path, "c")
    refused(FeatureError, "missing.h5: no such file", read_hloc_features, tmp_path / "missing.h5", "a")
    refused(FeatureError, "text.h5: not an h5 file", read_hloc_features, tmp_path / "text.h5", "a")


def test_what_is_not_installed_is_named(tmp_path, monkeypatch):
    for read, hint in ((read_colmap_features, "pycolmap>=4,<5"), (read_hloc_features, "h5py>=3.13,<4")):
        monkeypatch.setitem(sys.modules, hint.split(">")[0], None)
        refused(FeatureError, f"pip install '{hint}'", read, tmp_path / "a", "a")
