"""Pictures that share a watermark, bars of a screen or a time stamp: what does not move decides nothing."""

from functools import cache

import cv2
import numpy as np
import pytest

from epiprior.matching.baselines import standard_matches
from epiprior.types import Status
from epiprior.verification.confidence import load_confidence
from epiprior.verification.facts import apart_from_overlay, share_in_place
from pictures import relief_pair, smooth
from synthetic import run


def put(picture, text, x, y, colour=255):
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.7, colour, 2, cv2.LINE_AA)


def with_overlay(picture, kind):
    picture = picture.copy()
    if kind == "tiled watermark":
        for y in range(40, 380, 75):
            for x in range(0, 480, 160):
                put(picture, "(c) Sample", x + 8, y)
    elif kind == "bars of a screen":
        picture[:48], picture[-56:] = 30, 235
        for i, word in enumerate(("12:47", "Photos", "Search", "LTE 83%")):
            put(picture, word, 10 + 120 * i, 31, 220)
            put(picture, word[::-1], 10 + 120 * i, 340, 20)
    else:
        put(picture, "2019-07-21 14:32:05", 140, 345)
    return picture


@cache
def unrelated(kind, seed):
    """Matches of two pictures as smooth as photographs, which have nothing but the overlay in common."""
    return standard_matches(*(with_overlay(smooth(s), kind) for s in (2 * seed, 2 * seed + 1)))


KINDS = [("tiled watermark", 0), ("tiled watermark", 1), ("bars of a screen", 0), ("time stamp", 2)]


@pytest.mark.parametrize(("kind", "seed"), KINDS)
@pytest.mark.parametrize("estimator", ["epiprior", "magsac++"])
def test_text_from_what_cannot_move_with_the_scene_decides_nothing(kind, seed, estimator):
    matches = unrelated(kind, seed)
    found, other = run(estimator, matches), run(estimator, matches.swapped())
    assert found.status is not Status.OK
    assert found.confidence < load_confidence().min_confidence
    assert (other.status, other.geometry, other.confidence) == (found.status, found.geometry, found.confidence)


def test_matches_on_an_overlay_are_not_apart_from_it():
    matches = unrelated("bars of a screen", 0)
    still = np.linalg.norm(matches.x2 - matches.x1, axis=1) < 1
    assert still.sum() >= 3
    assert not apart_from_overlay(matches.x1, matches.x2)[still].any()
    assert share_in_place(matches.x1[still], matches.x2[still]) == 1
    moving = standard_matches(*relief_pair())
    assert apart_from_overlay(moving.x1, moving.x2).all()
    assert share_in_place(moving.x1[:0], moving.x2[:0]) == 0


@pytest.mark.parametrize("kind", sorted({kind for kind, _ in KINDS}))
def test_a_scene_that_moves_behind_an_overlay_decides_f(kind):
    matches = standard_matches(*(with_overlay(picture, kind) for picture in relief_pair()))
    for estimator in ("epiprior", "magsac++"):
        assert run(estimator, matches).status is Status.OK
