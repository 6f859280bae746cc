from dataclasses import replace

import numpy as np
import pytest

import epiprior
from calls import refused
from epiprior.errors import FeatureError, ImageError, ModelError
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.geometry import sampson_distance
from epiprior.matching import pair
from epiprior.presets import DEFAULT, PAPER, FeatureSettings
from epiprior.ranking import hypothesis
from pictures import relief_pair, rotated, texture

PAIR = relief_pair()
ROWS_CORRESPOND = np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]], float)


@pytest.fixture(scope="module")
def ranked(model):
    return epiprior.rank_matches(*PAIR, model=model)


def test_the_set_is_sorted_its_top_right_and_its_bytes_the_same_whatever_the_threads(ranked, model, monkeypatch):
    assert len(ranked.sets) == 1
    best = ranked.sets[0]
    assert len(best) > 300
    order = np.lexsort((best.distance_ratio, -best.supporting_matrices, -best.probability))
    np.testing.assert_array_equal(best.probability[order], best.probability)
    assert ((best.probability >= 0) & (best.probability <= 1)).all()
    rows_agree = np.abs(best.x1[:, 1] - best.x2[:, 1]) < 2
    assert rows_agree[:100].mean() > 0.95
    assert rows_agree.mean() < 0.9  # the tail holds the wrong ones
    assert best.supporting_matrices.max() > 500
    assert (best.two_keypoint_probability > 0).any()
    names = {"features", "standard matches", "roll", "fixed orientation", "clusters", "putative matches"}
    names |= {"coherence", "2keypoints", "2keypoint classifier", "votes", "probabilities"}
    assert set(ranked.seconds) == names
    assert min(ranked.seconds.values()) > 0
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    for one, two in zip(ranked.sets, epiprior.rank_matches(*PAIR, model=model).sets, strict=True):
        for name in ("x1", "x2", "probability", "supporting_matrices", "rough_matrices"):
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_rough_matrices_are_in_given_pixels(model):
    left, right = relief_pair(640, 480)
    settings = replace(DEFAULT, features=FeatureSettings(max_image_size=320))
    found = epiprior.rank_matches(left, right, model=model, settings=settings).sets[0]
    assert found.x1[:, 0].max() > 400
    y = np.random.default_rng(0).uniform(0, 480, 50)
    x1 = np.column_stack([np.random.default_rng(1).uniform(0, 600, 50), y])
    x2 = x1 + [20.0, 0.0]
    np.testing.assert_allclose(np.linalg.norm(found.rough_matrices, axis=(1, 2)), 1)
    middle = [np.median(sampson_distance(F, x1, x2)) for F in found.rough_matrices]
    assert min(middle) < 3  # some are close to the truth: rows correspond
    assert np.median(sampson_distance(ROWS_CORRESPOND, x1, x2)) < 1e-9


def test_a_turned_image_is_matched_under_its_roll(model):
    turned, A = rotated(PAIR[1], 37.0)
    found = epiprior.rank_matches(PAIR[0], turned, model=model)
    assert len(found.sets) == 2
    first = found.sets[0]
    assert abs(first.roll_deg - 37.0) < 4
    assert found.sets[1].roll_deg == 0
    back = (first.x2 - A[:, 2]) @ np.linalg.inv(A[:, :2]).T
    assert (np.abs(first.x1[:100, 1] - back[:100, 1]) < 3).mean() > 0.9


def test_paper_preset_runs_both_hypotheses_always():
    prepared = pair.prepare_pair(*relief_pair(240, 180), PAPER)
    rolls = pair.roll_hypotheses(prepared, PAPER)
    assert (len(rolls), rolls[1]) == (2, 0)
    assert hypothesis.find_candidates(prepared, 0.0, PAPER).two_keypoints.descriptors.shape[1] == 6


def test_features_of_the_callers_own_and_what_does_not_fit_is_named(model, ranked):
    own = {f"features{side}": detect_features(load_photograph(image)) for side, image in enumerate(PAIR, start=1)}
    found = epiprior.rank_matches(*PAIR, **own, model=model).sets[0]
    np.testing.assert_array_equal(found.probability, ranked.sets[0].probability)
    for side, features in enumerate(own.values(), start=1):
        rows = getattr(found, f"feature{side}")
        np.testing.assert_array_equal(features.xy[rows], getattr(found, f"x{side}"))
        assert rows.max() > len(np.unique(features.xy, axis=0)) - 1  # rows of features, not of locations
    top = epiprior.rank_matches(None, None, **own, model=model).sets[0].take(slice(0, 100))
    assert (np.abs(top.x1[:, 1] - top.x2[:, 1]) < 2).mean() > 0.9
    left, right = relief_pair(240, 180)
    own = detect_features(load_photograph(left))
    short = replace(own, descriptors=own.descriptors[:, :64])
    refused(FeatureError, "image 1", epiprior.rank_matches, left[:100], right, features1=own, model=model)
    refused(ImageError, "image 2 is None", epiprior.rank_matches, left, None, model=model)
    refused(FeatureError, "image 2 are dict", epiprior.rank_matches, left, right, features2={}, model=model)
    refused(FeatureError, "64", epiprior.rank_matches, left, right, features1=short, model=model)
    message = r"model default asks for .*preset paper .*: scale_change_diff"
    refused(ModelError, message, epiprior.rank_matches, left, right, preset="paper", model=model)


@pytest.mark.parametrize("blank", [np.zeros((300, 300), np.uint8), np.zeros((10, 10), np.uint8)])
def test_no_texture_gives_empty_sets(model, blank):
    picture = texture(200, 200)
    for images in ((blank, picture), (picture, blank), (blank, blank)):
        found = epiprior.rank_matches(*images, model=model)
        assert [len(s) for s in (*found.sets, found.standard)] == [0, 0]
