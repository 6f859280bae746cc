"""Features: found, described at an orientation, and the images they are found in."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from epiprior.errors import ImageError
from epiprior.features import describe
from epiprior.features.describe import describe_at_orientation, describe_frames, normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.features.locations import unique_locations
from epiprior.matching.roll import expected_roll, orientation_differences
from epiprior.matching.standard import nearest_neighbours
from epiprior.presets import DETECTORS, FeatureSettings
from epiprior.types import Features
from pictures import rotated, save, texture

SIZE = (320, 240)


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0])
def test_fixed_orientation_turns_with_the_image(angle_deg):
    image = texture(*SIZE)
    turned, A = rotated(image, angle_deg)
    photo, photo_turned = load_photograph(image), load_photograph(turned)
    found = detect_features(photo)
    inside = np.flatnonzero(((found.xy > 40) & (found.xy < [280, 200])).all(axis=1) & (found.scale < 4))
    found = found.take(inside)
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
    few = found.take(np.arange(30))
    asked = ((found, 0.0), (found, 30.0), (few, 0.0))
    wanted = [describe_at_orientation(load_photograph(image), *each) for each in asked]
    assert not np.array_equal(wanted[0], wanted[1])
    described = []

    def counted(photograph, frames):
        described.append(len(frames))
        return describe_frames(photograph, frames)

    monkeypatch.setattr(describe, "describe_frames", counted)
    photo = load_photograph(image)
    for _ in range(2):
        for each, descriptors in zip(asked, wanted, strict=True):
            np.testing.assert_array_equal(describe_at_orientation(photo, *each), descriptors)
    assert described == [len(found), len(found), 30]
    with pytest.raises(ValueError, match="read-only"):
        describe_at_orientation(photo, found, 0.0)[0] = 0


def test_a_loaded_photograph_is_taken_as_it_is():
    image = texture(500, 300)
    for limit in (200, 1024):
        photo = load_photograph(image, limit)
        assert load_photograph(photo, limit) is photo
    with pytest.raises(ImageError, match="max_image_size 200"):
        load_photograph(photo, 200)
    with pytest.raises(ImageError, match="max_image_size 400"):
        load_photograph(load_photograph(image, 200), 400)


@pytest.mark.parametrize("angle_deg", [37.0, 90.0, -120.0])
def test_roll_is_recovered_from_a_turned_image(angle_deg):
    image = texture(*SIZE, 1)
    one = detect_features(load_photograph(image))
    two = detect_features(load_photograph(rotated(image, angle_deg)[0]))
    d1, d2 = (normalise_descriptors(f.descriptors, root=True, centred=True) for f in (one, two))
    forward, _ = nearest_neighbours(d1, d2)
    good = np.flatnonzero(forward.distance_ratio < 0.8)
    roll = expected_roll(orientation_differences(one.orientation_deg[good], two.orientation_deg[forward.nearest[good]]))
    assert abs((roll - angle_deg + 180) % 360 - 180) < 3


def test_described_again_at_their_own_orientation_features_look_the_same():
    photo = load_photograph(texture(*SIZE, 2))
    found = detect_features(photo)
    frames = np.column_stack([found.xy, found.scale, found.orientation_deg])
    again = normalise_descriptors(describe_frames(photo, frames), root=False, centred=True)
    first = normalise_descriptors(found.descriptors, root=False, centred=True)
    similarity = (first * again).sum(axis=1)
    assert np.median(similarity) > 0.999
    assert (similarity > 0.95).mean() > 0.98


def test_large_images_come_back_in_their_own_pixels():
    small = texture(640, 480, 3)
    large = cv2.resize(small, (1280, 960), interpolation=cv2.INTER_CUBIC)
    a = detect_features(load_photograph(small))
    b = detect_features(load_photograph(large, 640))
    assert b.image_size == (1280, 960)
    reference = (a.xy + 0.5) * 2 - 0.5
    nearest = np.array([np.hypot(*(b.xy - x).T).min() for x in reference])
    assert np.median(nearest) < 0.3
    assert np.median(b.scale) == pytest.approx(2 * np.median(a.scale), rel=0.1)


def test_working_map_is_the_change_of_coordinates():
    photo = load_photograph(texture(500, 300), 250)
    xy = np.array([[0.0, 0.0], [499.0, 299.0], [17.5, 80.25]])
    expected = xy @ photo.working_map[:2, :2].T + photo.working_map[:2, 2]
    np.testing.assert_allclose(photo.to_working(xy), expected)
    np.testing.assert_allclose(photo.to_given(photo.to_working(xy)), xy)


def test_colour_arrays_and_files_agree(tmp_path):
    colour = np.stack([texture(*SIZE, k) for k in range(3)], axis=2)
    difference = load_photograph(save(tmp_path / "x.png", colour)).grey.astype(int) - load_photograph(colour).grey
    assert np.abs(difference).max() <= 1


def coarse_texture(seed):
    """Noise whose coarse parts are strong: COLMAP keeps whole levels of scale, so that fine noise exceeds its limit."""
    rng = np.random.default_rng(seed)
    image = np.zeros((240, 320), np.float32)
    for k in (2, 4, 8, 16, 32):
        noise = rng.normal(size=(240 // k + 1, 320 // k + 1)).astype(np.float32)
        image += cv2.resize(noise, SIZE, interpolation=cv2.INTER_CUBIC) * k
    return cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.mark.parametrize("detector", DETECTORS)
def test_features_of_every_detector(detector):
    if detector == "colmap-sift":
        pytest.importorskip("pycolmap")
    found = detect_features(load_photograph(coarse_texture(4)), FeatureSettings(detector=detector, max_keypoints=200))
    assert 10 < len(found) <= 300
    assert found.descriptors.shape == (len(found), 128)
    assert (found.scale > 0).all()


def test_opencv_and_colmap_sift_agree_on_the_pixel_origin():
    pytest.importorskip("pycolmap")
    photo = load_photograph(texture(*SIZE, 5))
    a = detect_features(photo)
    b = detect_features(photo, FeatureSettings(detector="colmap-sift"))
    # COLMAP's threshold is lower: it finds what OpenCV finds, and more.
    nearest = np.array([np.hypot(*(b.xy - x).T).min() for x in a.xy])
    assert np.median(nearest) < 0.01


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4), np.float32), "float32"),
        (np.zeros((4, 4, 2), np.uint8), r"\(4, 4, 2\)"),
        (np.zeros((0, 4), np.uint8), "empty"),
        (7, "int"),
        ("no/such.jpg", "no/such.jpg"),
    ],
)
def test_bad_images_are_named(image, message):
    with pytest.raises(ImageError, match=message):
        load_photograph(image)


@pytest.mark.parametrize(("name", "data"), [("text.jpg", b"not an image"), ("empty.png", b"")])
def test_files_that_are_no_images_are_named(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ImageError, match=rf"{name}: not an image"):
        load_photograph(tmp_path / name)


@pytest.mark.parametrize("image", [np.zeros((200, 200), np.uint8), np.zeros((10, 10), np.uint8)])
def test_no_texture_no_features(image):
    assert len(detect_features(load_photograph(image))) == 0


def test_twins_are_one_location():
    found = Features(
        xy=np.array([[1.0, 2.0], [5.0, 5.0], [1.0, 2.0], [1.0, 2.0]]),
        scale=np.array([2.0, 1.0, 2.0, 3.0]),
        orientation_deg=np.array([10.0, 0.0, 200.0, 0.0]),
        descriptors=np.ones((4, 128), np.float32),
        image_size=(10, 10),
    )
    first, location = unique_locations(found)
    assert first.tolist() == [0, 1, 3]
    assert location.tolist() == [0, 1, 0, 2]


def test_normalised_descriptors():
    d = np.random.default_rng(0).random((5, 128)).astype(np.float32)
    d[2] = 0
    plain = normalise_descriptors(d, root=False, centred=True)
    expected = np.corrcoef(d[0], d[1])[0, 1]
    assert plain[0] @ plain[1] == pytest.approx(expected, abs=1e-5)
    assert (plain[2] == 0).all()
    root = normalise_descriptors(d, root=True, centred=False)
    bhattacharyya = np.sqrt(d[0] / d[0].sum()) @ np.sqrt(d[1] / d[1].sum())
    assert root[0] @ root[1] == pytest.approx(bhattacharyya, abs=1e-5)
