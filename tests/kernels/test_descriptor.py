"""Our SIFT descriptors beside OpenCV's, and beside sums that are written down as the definition reads."""

import math

import cv2
import numpy as np
import pytest

from epiprior.features.describe import describe_frames
from epiprior.features.images import load_photograph
from epiprior.features.scale_space import octave_levels
from epiprior.kernels.descriptor import describe_level
from pictures import texture


def slow_descriptor(level, x, y, sigma, angle):
    """Every second pixel from the nearest to (x, y), shared out among rows, columns and orientations by distance."""
    height, width = level.shape
    x, y = round(x), round(y)
    size = 3 * sigma
    hist = np.zeros((6, 6, 8))
    for i in range(-200, 201, 2):
        for j in range(-200, 201, 2):
            c = (j * math.cos(angle) + i * math.sin(angle)) / size + 2.5
            r = (i * math.cos(angle) - j * math.sin(angle)) / size + 2.5
            if not (0 < r < 5 and 0 < c < 5 and 0 < x + j < width - 1 and 0 < y + i < height - 1):
                continue
            dx = float(level[y + i, x + j + 1]) - float(level[y + i, x + j - 1])
            dy = float(level[y + i - 1, x + j]) - float(level[y + i + 1, x + j])
            weight = math.hypot(dx, dy) * math.exp(-(i * i + j * j) / (size * size * 8))
            o = (math.atan2(dy, dx) + angle) * 8 / (2 * math.pi) % 8
            for row in range(6):
                for column in range(6):
                    share = max(0, 1 - abs(r - row)) * max(0, 1 - abs(c - column))
                    for k in range(8) if share else ():
                        apart = abs(o - k)
                        hist[row, column, k] += weight * share * max(0, 1 - min(apart, 8 - apart))
    d = hist[1:5, 1:5].reshape(-1)
    d = np.minimum(d, 0.2 * np.linalg.norm(d))
    return np.minimum(np.rint(512 * d / max(np.linalg.norm(d), 1e-7)), 255)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0, 37.0, 359.99, -201.0])
def test_the_kernel_is_its_slow_twin(angle_deg):
    level = cv2.GaussianBlur(texture(90, 70, 3).astype(np.float32), (0, 0), 2.0)
    # In the middle, at an edge, at a corner, on a pixel's border, larger than the image, outside.
    places = [(45.2, 35.7, 2.0), (3.1, 30.0, 2.5), (88.0, 69.0, 3.0), (40.5, 35.5, 1.7), (44.0, 36.0, 30.0)]
    frames = np.array([(*place, math.radians(angle_deg)) for place in [*places, (500.0, -80.0, 2.0)]])
    found = np.full((len(frames) + 1, 128), -1.0, np.float32)
    describe_level(level.ravel(), *level.shape, frames, np.arange(len(frames)), found)
    for frame, descriptor in zip(frames, found, strict=False):
        # The kernel's arc tangent is right to 0.3 degrees.
        np.testing.assert_allclose(descriptor, slow_descriptor(level, *frame), atol=2.5)
    assert not found[-2].any()
    assert (found[-1] == -1).all()


def test_the_order_and_the_company_of_the_frames_change_nothing():
    photo = load_photograph(texture(320, 240, 1))
    rng = np.random.default_rng(0)
    frames = np.column_stack([rng.uniform(0, 320, 3000), rng.uniform(0, 240, 3000), rng.uniform(1, 20, 3000)])
    frames = np.column_stack([frames, rng.uniform(0, 360, 3000)])
    order = rng.permutation(3000)
    whole = describe_frames(photo, frames)
    np.testing.assert_array_equal(describe_frames(photo, frames[order]), whole[order])
    np.testing.assert_array_equal(describe_frames(load_photograph(photo.grey), frames[:1]), whole[:1])
    assert describe_frames(photo, frames[:0]).shape == (0, 128)
    photo = load_photograph(np.full((1, 1), 7, np.uint8))
    assert [level.shape for level in octave_levels(photo, 0)] == [(1, 1)] * 3
    assert not describe_frames(photo, np.array([[0.0, 0.0, 50.0, 0.0]])).any()


@pytest.mark.parametrize("fixed", [False, True])
def test_descriptors_are_nearly_those_of_opencv(fixed):
    grey = texture(640, 480, 5)
    sift = cv2.SIFT_create(enable_precise_upscale=True)
    keypoints = sift.detect(grey)
    if fixed:
        for keypoint in keypoints:
            keypoint.angle = 25.0
    keypoints, theirs = sift.compute(grey, keypoints)
    ours = describe_frames(load_photograph(grey), np.array([(*k.pt, k.size / 2, k.angle) for k in keypoints]))
    cosine = (ours * theirs).sum(axis=1) / (np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1))
    assert np.median(cosine) > 0.999
    assert np.quantile(cosine, 0.01) > 0.99
