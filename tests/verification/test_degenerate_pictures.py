"""Pictures of a plane, and by a turning camera: detected, matched and estimated, nothing decides F. Relief does."""

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from epiprior.matching.baselines import snn_matches
from epiprior.types import FloatArray, MatchSet, Status
from pictures import relief_pair, texture
from synthetic import rotation, run

SIZE = (480, 360)
CAMERA = np.array([[420.0, 0.0, 240.0], [0.0, 420.0, 180.0], [0.0, 0.0, 1.0]])


def photograph(H: FloatArray, seed: int) -> NDArray[np.uint8]:
    """A textured plane under a homography, with the noise of a sensor."""
    seen = cv2.warpPerspective(texture(720, 540, 3), H, SIZE, flags=cv2.INTER_AREA)
    noisy = seen + np.random.default_rng(seed).normal(0, 4.0, seen.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


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
    t = np.zeros(3) if scene == "rotation" else -turned @ np.array([1.6, 0.2, 0.3])
    first, second = plane_view(still, np.zeros(3)), plane_view(turned, t)
    return snn_matches(photograph(first, 0), photograph(second, 1))


@pytest.mark.parametrize("name", ["usac", "magsac++", "epiprior"])
def test_a_turning_camera_decides_nothing(name):
    estimate = run(name, matches_of("rotation"))
    assert estimate.status is Status.DEGENERATE
    assert "homography" in estimate.message


@pytest.mark.parametrize(("name", "seeds"), [("usac", 20), ("magsac++", 20), ("epiprior", 1)])
def test_a_photographed_plane_decides_nothing(name, seeds):
    """Where chance puts a third wrong match on the epipolar lines of two others, F passes for decided.

    `epiprior.verification.degeneracy.why_degenerate` tells how often, docs/degeneracy.md what follows. Here it is half
    of the seeds with OpenCV 5, less with 4.13: one seed would be a lottery.
    """
    matches = matches_of("plane")
    assert len(matches) > 100
    estimates = [run(name, matches, seed=seed) for seed in range(seeds)]
    seen = [estimate for estimate in estimates if estimate.status is Status.DEGENERATE]
    assert len(seen) >= 0.4 * seeds
    assert all("homography" in estimate.message for estimate in seen)


@pytest.mark.parametrize("name", ["usac", "magsac++", "epiprior"])
def test_photographed_relief_decides_f(name):
    estimate = run(name, matches_of("relief"))
    assert estimate.status is Status.OK
    assert estimate.support > 50
