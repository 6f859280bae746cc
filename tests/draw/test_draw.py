"""The figure: its size, what is drawn where, in which colours; and what it refuses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calls import refused
from epiprior import OutputError, Status
from epiprior.draw.captions import draw_header, probability_colours
from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture
from pictures import save, texture
from synthetic import make_estimate, make_matches, make_pair

BLACK = np.zeros((768, 1024), np.uint8)
ONE_MATCH = make_matches([[1.0, 1.0]], [[1.0, 1.0]], np.array([0.5]))


def coloured(picture):
    return np.ptp(picture.astype(int), axis=2) > 40


def test_epipolar_lines_have_a_row_with_a_matrix_and_pass_through_their_points():
    pair = make_pair(seed=1)
    with_lines = draw_matches(BLACK, BLACK, pair.matches, make_estimate(pair))
    without = draw_matches(BLACK, BLACK, pair.matches, make_estimate(pair, Status.NO_MODEL, message="nothing fits"))
    plain = draw_matches(BLACK, BLACK, pair.matches)
    assert (with_lines.dtype, with_lines.shape[1:]) == (np.uint8, (2 * 1024 + 8, 3))
    assert with_lines.shape[0] > without.shape[0] + 768
    assert without.shape == plain.shape
    pair = make_pair(noise_px=0.0, outliers=0, seed=3)
    row = draw_matches(BLACK, BLACK, pair.matches, make_estimate(pair), settings=DrawSettings(epipolar_lines=1))[-768:]
    x1, x2 = pair.matches.x1[0], pair.matches.x2[0]
    for left, F, here, there in ((0, pair.F.T, x1, x2), (1032, pair.F, x2, x1)):
        view = row[:, left : left + 1024]
        a, b, c = F @ [*there, 1.0]
        y, x = np.nonzero(coloured(view))
        distance = np.abs(a * x + b * y + c) / np.hypot(a, b)
        away = np.hypot(x - here[0], y - here[1]) > 8
        assert away.sum() > 500
        assert distance[away].max() < 3
        assert np.hypot(x - here[0], y - here[1]).min() < 1


@pytest.mark.parametrize(
    ("column", "value", "shown"), [("probability", 0.1, 0.1), ("probability", 0.9, 0.9), ("distance_ratio", 0.2, 0.8)]
)
def test_a_match_is_drawn_at_its_place_in_the_colour_of_its_probability_or_ratio(column, value, shown):
    x1, x2 = np.array([[100.0, 200.0]]), np.array([[700.0, 600.0]])
    picture = draw_matches(BLACK, BLACK, make_matches(x1, x2, **{column: np.array([value])}))
    top = picture.shape[0] - 768
    for x, y in ((100, 200), (1024 + 8 + 700, 600)):
        np.testing.assert_allclose(picture[top + y, x], probability_colours(np.array([shown]))[0], atol=2)
    assert not coloured(picture[top:])[250:550, :90].any()


def test_best_matches_only_one_per_feature_and_none_outside():
    x1, x2 = np.random.default_rng(0).uniform(20, 700, (2, 60, 2))
    matches = make_matches(x1, x2, np.linspace(1, 0.2, 60), feature1=np.arange(60) // 2)
    few = draw_matches(BLACK, BLACK, matches, settings=DrawSettings(max_matches=1))
    many = draw_matches(BLACK, BLACK, matches, settings=DrawSettings(max_matches=60))
    only = draw_matches(BLACK, BLACK, matches.take(slice(0, 60, 2)), settings=DrawSettings(max_matches=60))
    body = slice(many.shape[0] - 768, None)
    assert coloured(many[body]).sum() > 5 * coloured(few[body]).sum()
    np.testing.assert_array_equal(many[body], only[body])
    empty = make_matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
    assert not coloured(draw_matches(BLACK, BLACK, empty)[120:]).any()
    outside = make_matches([[-900.0, 5.0], [5e9, 5.0]], [[10.0, 10.0], [10.0, 10.0]], np.array([0.9, 0.9]))
    assert not coloured(draw_matches(BLACK, BLACK, outside)[120:]).any()


@pytest.mark.parametrize(
    ("shape1", "shape2"),
    [((10, 10), (768, 1024, 3)), ((3000, 4000), (480, 640)), ((900, 300), (300, 900)), ((8, 2000), (2000, 8))],
)
def test_any_sizes_fit(shape1, shape2):
    images = [np.full(shape, 90, np.uint8) for shape in (shape1, shape2)]
    inside = np.array([[1.0, 1.0], [shape1[1] - 2.0, shape1[0] - 2.0]])
    other = np.array([[1.0, 1.0], [shape2[1] - 2.0, shape2[0] - 2.0]])
    picture = draw_matches(*images, make_matches(inside, other, np.array([0.9, 0.8])))
    assert 900 <= picture.shape[1] <= 2056
    assert picture.shape[0] <= 1200
    assert coloured(picture[120:]).any()


def test_large_images_are_scaled_with_their_points_and_lines():
    large = np.zeros((1536, 2048), np.uint8)
    small = draw_matches(BLACK, BLACK, make_matches([[100.0, 200.0]], [[300.0, 500.0]], np.array([0.9])))
    twice = draw_matches(large, large, make_matches([[200.5, 400.5]], [[600.5, 1000.5]], np.array([0.9])))
    np.testing.assert_array_equal(small, twice)
    pair = make_pair(seed=3)
    found, none = make_estimate(pair), pair.matches.take(slice(0, 0))
    D = np.linalg.inv(np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]]))
    scaled = replace(found, F=D.T @ pair.F @ D, x1=2 * found.x1 + 0.5, x2=2 * found.x2 + 0.5)
    small = draw_matches(BLACK, BLACK, none, found).astype(int)
    # Up to rounding to a sixteenth of a pixel.
    assert np.abs(small - draw_matches(large, large, none, scaled)).max() < 40


def test_a_file_and_its_array_give_the_same_figure_which_is_read_back_as_written(tmp_path):
    rgb = np.dstack([texture(200, 150, seed) for seed in range(3)])
    path = save(tmp_path / "a.png", rgb)
    matches = make_matches([[20.0, 30.0]], [[50.0, 60.0]], np.array([0.7]))
    np.testing.assert_array_equal(draw_matches(path, rgb, matches), draw_matches(rgb, str(path), matches))
    write_picture(tmp_path / "b.png", rgb)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "b.png"))[:, :, ::-1], rgb)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]
    refused(OutputError, r"a\.tiff", write_picture, tmp_path / "a.tiff", rgb)
    refused(OutputError, "missing", write_picture, tmp_path / "missing" / "a.png", rgb)


def test_long_messages_stay_left_of_the_colour_scale():
    none = [make_estimate(make_pair(seed=1), Status.NO_MODEL, message=text) for text in ("", "word " * 60)]
    short, long = (draw_header(968, estimate, 5, "probability") for estimate in none)
    np.testing.assert_array_equal(short[:, 700:], long[:, 700:])
    assert (short != long).any()
