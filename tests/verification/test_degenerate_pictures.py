"""Pictures of every kind, detected, matched and estimated: only relief decides F, in either order of the images."""

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from epiprior.matching.baselines import snn_matches, standard_matches
from epiprior.types import FloatArray, FundamentalEstimate, Geometry, MatchSet, Status
from epiprior.verification.degeneracy import homography_distance
from pictures import relief_pair, smooth, texture
from synthetic import rotation, run

SIZE = (480, 360)
CAMERA = np.array([[420.0, 0.0, 240.0], [0.0, 420.0, 180.0], [0.0, 0.0, 1.0]])


def photograph(H: FloatArray, seed: int) -> NDArray[np.uint8]:
    """A textured plane under a homography, with the noise of a sensor."""
    seen = cv2.warpPerspective(texture(720, 540, 3), H, SIZE, flags=cv2.INTER_AREA)
    return np.clip(seen + np.random.default_rng(seed).normal(0, 4.0, seen.shape), 0, 255).astype(np.uint8)


def plane_view(R: FloatArray, t: FloatArray) -> FloatArray:
    """The homography from the texture, 6 units wide and 10 away, to a camera."""
    to_world = np.array([[6 / 720, 0, -3.0], [0, 6 / 720, -2.25], [0, 0, 1.0]])
    view: FloatArray = CAMERA @ np.column_stack([R[:, 0], R[:, 1], R @ np.array([0, 0, 6.0]) + t]) @ to_world
    return view


@cache
def matches_of(scene: str) -> MatchSet:
    still, turned = np.eye(3), rotation((0.15, 1.0, 0.1), 14.0)
    if scene == "relief":
        return snn_matches(*relief_pair())
    if scene not in ("plane", "rotation"):
        return snn_matches(smooth(5, 1.5), copy_of(smooth(5, 1.5), scene))
    t = np.zeros(3) if scene == "rotation" else -turned @ np.array([1.6, 0.2, 0.3])
    first, second = plane_view(still, np.zeros(3)), plane_view(turned, t)
    return snn_matches(photograph(first, 0), photograph(second, 1))


def both_orders(name: str, matches: MatchSet) -> FundamentalEstimate:
    """The estimate, after a check that it is the same with the images in the other order."""
    one, other = run(name, matches), run(name, matches.swapped())
    assert (one.status, one.geometry, one.message) == (other.status, other.geometry, other.message)
    assert one.confidence == pytest.approx(other.confidence, abs=1e-12, nan_ok=True)
    assert one.support == other.support
    if one.F is not None:
        assert np.array_equal(one.F, other.F.T)
    return one


def homography_holds(found: FundamentalEstimate) -> bool:
    near = homography_distance(found.H, found.x1, found.x2) < 4.0
    return bool(np.array_equal(near, found.inliers)) and found.support == near.sum() > 50


@pytest.mark.parametrize("name", ["usac", "magsac++", "epiprior"])
@pytest.mark.parametrize("scene", ["plane", "rotation"])
def test_a_photographed_plane_and_a_turning_camera_decide_nothing(scene, name):
    found = both_orders(name, matches_of(scene))
    assert found.status is Status.DEGENERATE
    told = (scene, name) == ("rotation", "magsac++")
    assert found.geometry in ((Geometry.ROTATION,) if told else (Geometry.PLANAR, Geometry.ROTATION))
    assert "F is not determined" in found.message
    assert homography_holds(found)


@pytest.mark.parametrize("name", ["usac", "magsac++", "epiprior"])
def test_photographed_relief_decides_f(name):
    found = both_orders(name, matches_of("relief"))
    assert (found.status, found.geometry, found.H) == (Status.OK, Geometry.GENERAL, None)
    assert found.support > 50


def copy_of(picture: NDArray[np.uint8], form: str) -> NDArray[np.uint8]:
    if form == "resized":
        picture = cv2.resize(picture, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    elif form == "framed":
        picture = cv2.copyMakeBorder(picture, 20, 35, 30, 15, cv2.BORDER_CONSTANT, value=250)
    elif form == "cropped":
        picture = picture[60:300, 90:420]
    elif form == "turned":
        picture = np.rot90(picture)
    data = cv2.imencode(".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


@pytest.mark.parametrize("form", ["recompressed", "resized", "framed", "cropped", "turned"])
@pytest.mark.parametrize("name", ["magsac++", "epiprior"])
def test_copies_of_one_picture_are_told(form, name):
    found = run(name, matches_of(form))
    assert (found.status, found.geometry) == (Status.DEGENERATE, Geometry.IDENTICAL)
    assert "copies of one picture" in found.message
    assert homography_holds(found)


@pytest.mark.parametrize("seed", range(3))
def test_pictures_of_different_places_have_nothing_in_common(seed):
    matches = standard_matches(smooth(2 * seed), smooth(2 * seed + 1))
    for found in (run("magsac++", matches), both_orders("epiprior", matches)):
        assert found.status in (Status.NO_MODEL, Status.TOO_FEW_MATCHES)
        assert (found.geometry, found.H) == (Geometry.NONE, None)


def test_polygons_drawn_in_both_pictures_are_no_scene():
    """The same flat polygons over two unrelated textures, moved as one: a plane, or nothing, but no F."""
    rng = np.random.default_rng(0)
    corners = [rng.integers(40, 300, (6, 2)) for _ in range(12)]
    pictures = []
    for seed, shift in ((1, 0), (2, 25)):
        picture = smooth(seed)
        for k, polygon in enumerate(corners):
            cv2.fillPoly(picture, [(polygon + [shift, 0]).astype(np.int32)], 20 * k)
        pictures.append(picture)
    assert both_orders("magsac++", standard_matches(*pictures)).status is not Status.OK
