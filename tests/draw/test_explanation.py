"""The picture of an explanation: the match, its line and its partners at their places, far and near."""

from dataclasses import replace

import numpy as np
import pytest

from epiprior.draw.captions import probability_colours
from epiprior.draw.explanation import draw_explanation
from epiprior.explain import ExplainedColumn, ExplainedRound, Explanation, SupportedMatrix
from synthetic import make_matches

BLACK = np.zeros((540, 720), np.uint8)  # drawn at its own size
SIDE_BY_SIDE = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # rows correspond
RANKED = make_matches([[360.0, 270.0], [460.0, 270.0]], [[200.0, 272.0], [250.0, 272.0]], np.array([0.9, 0.6]))
NUMBERS = {"residual_px": 1.4, "inliers": 3, "probability_sum": 2.5}
BEST = SupportedMatrix(index=0, F=SIDE_BY_SIDE, made_of=np.zeros((2, 2), int), **NUMBERS)
ROUND = ExplainedRound(probability=0.9, judged=2, columns=(ExplainedColumn("similarity", 1, 2, 3, 0.5, 0.6),))
PARTNERS = {"partners": np.array([1]), "partner_probability": np.array([0.6]), "partner_voted": np.array([True])}
PLACE = {"match": 0, "set": 0, "row": 0, "ranked": RANKED, "turned": False}
EXPLANATION = Explanation(**PLACE, **PARTNERS, rounds=(ROUND,), in_x=True, self_made=0, best=BEST)
DOT, PARTNER = (np.array(colour) for colour in probability_colours(np.array([0.9, 0.6])))
ORANGE = np.array([255, 140, 60])


def rows_of_images(picture):
    """The two rows of images, left and right: what is mostly black."""
    dark = np.flatnonzero((picture == 0).all(axis=2).mean(axis=1) > 0.5)
    tops = dark[0], dark[dark >= dark[0] + 540][0]
    return [[picture[top : top + 540, left : left + 720] for left in (0, 728)] for top in tops]


def near(panel, colour):
    return np.argwhere(np.abs(panel.astype(int) - colour).max(axis=2) < 30)[:, ::-1]


def test_the_match_and_its_lines_are_where_they_are_in_the_images_and_partners_are_shown_nearer():
    (left, right), nearer = rows_of_images(draw_explanation(BLACK, BLACK, EXPLANATION))
    for panel, (x, y), row in ((left, (360, 270), 272), (right, (200, 272), 270)):
        np.testing.assert_allclose(near(panel, DOT).mean(axis=0), (x, y), atol=0.5)
        line = near(panel, ORANGE)
        assert len(line) > 1000
        np.testing.assert_allclose(np.median(line[:, 1]), row, atol=1)
        assert not len(near(panel, PARTNER))
    for panel, step in zip(nearer, (100, 50), strict=True):
        match, partner = near(panel, DOT).mean(axis=0), near(panel, PARTNER)
        np.testing.assert_allclose(match, (360, 270), atol=4)  # in the middle, up to a pixel of the image
        end = partner[partner[:, 0] > partner[:, 0].max() - 8].mean(axis=0)
        np.testing.assert_allclose(end - match, (step * 540 / np.ceil(2 * 1.15 * step), 0), atol=5)


def test_what_there_is_not_is_not_drawn():
    none = {name: values[:0] for name, values in PARTNERS.items()}
    alone = replace(EXPLANATION, best=None, in_x=False, **none)
    assert "outside X" in alone.sentences()[0]
    for row in rows_of_images(draw_explanation(BLACK, BLACK, alone)):
        for panel in row:
            assert len(near(panel, DOT))
            assert not len(near(panel, ORANGE))
            assert not len(near(panel, PARTNER))


@pytest.mark.parametrize("corner", [(0.0, 0.0), (719.0, 539.0)])
def test_at_the_border_of_images_of_any_size(corner):
    ranked = make_matches([corner, [300.0, 300.0]], [[3.0, 3.0], [4.0, 5.0]], np.array([0.9, 0.6]))
    picture = draw_explanation(BLACK, np.zeros((10, 30), np.uint8), replace(EXPLANATION, ranked=ranked))
    assert picture.shape[1] > 900
    assert len(near(picture, PARTNER))
