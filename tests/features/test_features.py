from dataclasses import replace

import cv2
import numpy as np
import pytest

from calls import note_calls, refused
from epiprior.errors import ImageError
from epiprior.features import describe
from epiprior.features.describe import describe_at_orientation, normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.features.locations import unique_locations
from epiprior.presets import DETECTORS, FeatureSettings
from epiprior.types import Features
from pictures import rotated, save, smooth, texture

SIZE = (320, 240)


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0])
def test_fixed_orientation_turns_with_the_image(angle_deg):
    image = texture(*SIZE)
    turned, A = rotated(image, angle_deg)
    photo, photo_turned = load_photograph(image), load_photograph(turned)
    found = detect_features(photo)
    found = found.take(np.flatnonzero(((found.xy > 40) & (found.xy < [280, 200])).all(axis=1) & (found.scale < 4)))
    moved = replace(found, xy=found.xy @ A[:, :2].T + A[:, 2], image_size=photo_turned.size)
    one = normalise_descriptors(describe_at_orientation(photo, found, 0.0), root=False, centred=True)
    similarity = {}
    for sign in (1, -1):
        other = describe_at_orientation(photo_turned, moved, sign * angle_deg)
        two = normalise_descriptors(other, root=False, centred=True)
        similarity[sign] = float(np.median((one * two).sum(axis=1)))
    assert similarity[1] > 0.95
    if angle_deg:
        assert similarity[-1] < 0.6


def test_a_photograph_is_described_once_per_orientation(monkeypatch):
    image = texture(*SIZE)
    found = detect_features(load_photograph(image))
    asked = ((found, 0.0), (found, 30.0), (found.take(np.arange(30)), 0.0))
    wanted = [describe_at_orientation(load_photograph(image), *each) for each in asked]
    assert not np.array_equal(wanted[0], wanted[1])
    calls = note_calls(monkeypatch, describe, "describe_frames")
    photo = load_photograph(image)
    for _ in range(2):
        for each, descriptors in zip(asked, wanted, strict=True):
            np.testing.assert_array_equal(describe_at_orientation(photo, *each), descriptors)
    assert [len(frames) for (_, frames), _ in calls] == [len(found), len(found), 30]
    with pytest.raises(ValueError, match="read-only"):
        describe_at_orientation(photo, found, 0.0)[0] = 0


def test_a_loaded_photograph_is_taken_as_it_is_and_colour_arrays_and_files_agree(tmp_path):
    image = texture(500, 300)
    for limit in (200, 1024):
        photo = load_photograph(image, limit)
        assert load_photograph(photo, limit) is photo
    refused(ImageError, "max_image_size 200", load_photograph, photo, 200)
    refused(ImageError, "max_image_size 400", load_photograph, load_photograph(image, 200), 400)
    colour = np.stack([texture(*SIZE, k) for k in range(3)], axis=2)
    difference = load_photograph(save(tmp_path / "x.png", colour)).grey.astype(int) - load_photograph(colour).grey
    assert np.abs(difference).max() <= 1


def test_large_images_come_back_in_their_own_pixels():
    small = texture(640, 480, 3)
    large = load_photograph(cv2.resize(small, (1280, 960), interpolation=cv2.INTER_CUBIC), 640)
    a, b = detect_features(load_photograph(small)), detect_features(large)
    assert b.image_size == (1280, 960)
    assert np.median([np.hypot(*(b.xy - x).T).min() for x in (a.xy + 0.5) * 2 - 0.5]) < 0.3
    assert np.median(b.scale) == pytest.approx(2 * np.median(a.scale), rel=0.1)
    expected = b.xy @ large.working_map[:2, :2].T + large.working_map[:2, 2]
    np.testing.assert_allclose(large.to_working(b.xy), expected)
    np.testing.assert_allclose(large.to_given(expected), b.xy)


@pytest.mark.parametrize("detector", DETECTORS)
def test_features_of_every_detector(detector):
    if detector == "colmap-sift":
        pytest.importorskip("pycolmap")
    found = detect_features(load_photograph(smooth(4, 4.0)), FeatureSettings(detector=detector, max_keypoints=200))
    assert 10 < len(found) <= 300
    assert found.descriptors.shape == (len(found), 128)
    assert (found.scale > 0).all()


def test_opencv_and_colmap_sift_agree_on_the_pixel_origin():
    pytest.importorskip("pycolmap")
    photo = load_photograph(texture(*SIZE, 5))
    a = detect_features(photo)
    b = detect_features(photo, FeatureSettings(detector="colmap-sift"))
    # COLMAP's threshold is lower: it finds what OpenCV finds, and more.
    assert np.median([np.hypot(*(b.xy - x).T).min() for x in a.xy]) < 0.01


def test_bad_images_are_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.jpg").write_bytes(b"not an image")
    (tmp_path / "empty.png").touch()
    refused(ImageError, "float32", load_photograph, np.zeros((4, 4), np.float32))
    refused(ImageError, r"\(4, 4, 2\)", load_photograph, np.zeros((4, 4, 2), np.uint8))
    refused(ImageError, "empty", load_photograph, np.zeros((0, 4), np.uint8))
    refused(ImageError, "int", load_photograph, 7)
    refused(ImageError, "no/such.jpg", load_photograph, "no/such.jpg")
    for name in ("text.jpg", "empty.png"):
        refused(ImageError, f"{name}: not an image", load_photograph, name)


def test_twins_are_one_location():
    xy, scale = np.array([[1.0, 2.0], [5.0, 5.0], [1.0, 2.0], [1.0, 2.0]]), np.array([2.0, 1.0, 2.0, 3.0])
    rest = {"orientation_deg": np.array([10.0, 0.0, 200.0, 0.0]), "descriptors": np.ones((4, 128), np.float32)}
    first, location = unique_locations(Features(xy=xy, scale=scale, **rest, image_size=(10, 10)))
    assert (first.tolist(), location.tolist()) == ([0, 1, 3], [0, 1, 0, 2])


def test_normalised_descriptors():
    d = np.random.default_rng(0).random((5, 128)).astype(np.float32)
    d[2] = 0
    plain = normalise_descriptors(d, root=False, centred=True)
    assert plain[0] @ plain[1] == pytest.approx(np.corrcoef(d[0], d[1])[0, 1], abs=1e-5)
    assert (plain[2] == 0).all()
    root = normalise_descriptors(d, root=True, centred=False)
    assert root[0] @ root[1] == pytest.approx(np.sqrt(d[0] / d[0].sum()) @ np.sqrt(d[1] / d[1].sum()), abs=1e-5)
