"""Two photographs in, F out: which matches the estimator gets, and what is done twice."""

from dataclasses import replace

import numpy as np
import pytest

from calls import note_calls, refused
from epiprior import two_view
from epiprior.errors import EstimatorError, ImageError, SettingsError
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.geometry import sampson_distance
from epiprior.matching import pair as matching
from epiprior.matching.baselines import snn_matches
from epiprior.presets import DEFAULT, FeatureSettings, find_preset
from epiprior.two_view import estimate_fundamental
from epiprior.types import MatchSet, RankedMatches, Status
from epiprior.verification.cascade import CascadeRule
from pictures import relief_pair, texture
from synthetic import make_pair

LEFT, RIGHT = relief_pair(240, 180)
KEEP_ALL = CascadeRule(min_confidence=0.0)
KEEP_NONE = CascadeRule(min_confidence=1.0)


def ranked_of(matches: MatchSet, standard: MatchSet) -> RankedMatches:
    return RankedMatches(sets=(matches,), standard=standard, seconds={"votes": 0.5}, preset="default")


def test_two_pictures_without_preprocessing():
    left, right = relief_pair()
    estimate = estimate_fundamental(left, right, mode="standard")
    assert estimate.status is Status.OK
    # Cameras side by side: epipolar lines are rows.
    rows = np.array([[0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    assert sampson_distance(rows, estimate.x1, estimate.x2)[estimate.inliers].max() < 3.0
    grid = np.stack(np.meshgrid([60.0, 240, 420], [50.0, 180, 310]), axis=-1).reshape(-1, 2)
    assert sampson_distance(estimate.F, grid, grid - [25.0, 0.0]).max() < 2.0
    assert {"standard matches", "estimator", "support"} <= set(estimate.seconds)


@pytest.fixture
def ranking(monkeypatch):
    """Stands in for `rank_matches`: notes what it is given, returns what the test puts in."""
    state = {"calls": [], "matches": make_pair().matches}

    def rank(image1, image2, **options):
        state["calls"].append(options)
        return ranked_of(state["matches"], state["matches"])

    monkeypatch.setattr(two_view, "rank_matches", rank)
    return state


def test_images_are_ranked_with_the_preset_and_ranked_matches_are_used(ranking):
    pair, picture = make_pair(), texture()
    ranked = ranked_of(pair.matches, pair.matches.take(slice(7)))
    estimate = estimate_fundamental(picture, picture, ranked=ranked)
    assert pair.error_px(estimate.F) < 0.6
    assert estimate.seconds["votes"] == 0.5
    assert estimate_fundamental(picture, picture, ranked=ranked, mode="standard").status is Status.TOO_FEW_MATCHES
    assert ranking["calls"] == []
    how = {"preset": "paper", "estimator": "prosac", "mode": "preprocess", "threshold_px": 2.5}
    estimate = estimate_fundamental(texture(), texture(), **how)
    assert [call["settings"].name for call in ranking["calls"]] == ["paper"]
    assert estimate.estimator == "prosac"
    assert np.array_equal(estimate.inliers, sampson_distance(estimate.F, estimate.x1, estimate.x2) < 2.5)


def test_options_that_are_unknown_or_contradict_each_other_are_refused_before_any_work(ranking):
    for options, named in (
        ({"estimator": "usak"}, "'usak'"),
        ({"mode": "waterfall"}, "mode is 'waterfall', known: cascade, preprocess, standard"),
        ({"mode": "cascade", "hand_over": HandOver()}, "hand_over is for one input"),
        ({"rule": KEEP_ALL, "hand_over": HandOver()}, "rule is of the cascade, but mode is 'preprocess'"),
        ({"rule": KEEP_ALL, "mode": "standard"}, "rule is of the cascade, but mode is 'standard'"),
    ):
        refused((EstimatorError, SettingsError), named, estimate_fundamental, texture(), texture(), **options)
    assert ranking["calls"] == []


def test_a_kept_estimate_is_the_one_on_simple_matches_and_what_was_ranked_before_is_used(ranking):
    kept = estimate_fundamental(LEFT, RIGHT, rule=KEEP_ALL)
    assert ranking["calls"] == []
    simple = estimate_from_matches([snn_matches(LEFT, RIGHT)], estimator="epiprior", hand_over=HandOver())
    assert kept.F.tobytes() == simple.F.tobytes()
    assert (kept.input, set(kept.seconds)) == ("snn", {"features", "standard matches", "estimator", "support"})
    good = make_pair()
    ranked = ranked_of(good.matches, good.matches)
    used = estimate_fundamental(LEFT, RIGHT, mode="cascade", ranked=ranked, rule=KEEP_NONE)
    assert ranking["calls"] == []
    assert (used.input, estimate_fundamental(LEFT, RIGHT, ranked=ranked).input) == ("default", "default")
    assert good.error_px(used.F) < 0.6


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_what_is_not_kept_is_ranked_from_the_same_features(ranking, monkeypatch, preset):
    detected = note_calls(monkeypatch, matching, "detect_features")
    estimate = estimate_fundamental(LEFT, RIGHT, mode="cascade", rule=KEEP_NONE, preset=preset)
    assert len(detected) == 2
    (call,) = ranking["calls"]
    assert call["settings"] == find_preset(preset)
    assert len(call["features1"]) > 50
    assert call["features1"].image_size == call["features2"].image_size == (240, 180)
    assert (estimate.status, estimate.input) == (Status.OK, preset)
    assert {"first input", "votes", "estimator"} <= set(estimate.seconds)
    assert estimate.seconds["votes"] == 0.5


def test_shared_features_change_no_bit(tiny_model):
    twice = estimate_fundamental(LEFT, RIGHT, mode="cascade", rule=KEEP_NONE)
    once = estimate_fundamental(LEFT, RIGHT, mode="preprocess")
    assert twice.status is Status.OK
    assert twice.F.tobytes() == once.F.tobytes()
    assert np.array_equal(twice.inliers, once.inliers)


def test_a_threshold_and_the_settings_of_features_are_of_both_inputs(ranking):
    fewer = replace(DEFAULT, features=FeatureSettings(max_keypoints=60, max_image_size=200))
    estimate_fundamental(LEFT, RIGHT, mode="cascade", rule=KEEP_NONE, settings=fewer)
    (call,) = ranking["calls"]
    assert call["settings"] is fewer
    assert 30 < len(call["features1"]) <= 70
    for rule in (KEEP_ALL, KEEP_NONE):
        estimate = estimate_fundamental(LEFT, RIGHT, mode="cascade", rule=rule, threshold_px=0.8)
        assert np.array_equal(estimate.inliers, sampson_distance(estimate.F, estimate.x1, estimate.x2) < 0.8)


@pytest.mark.parametrize("estimator", ["usac", "generalized-ransac"])
def test_features_of_the_callers_own_are_used_on_both_inputs(ranking, monkeypatch, estimator):
    monkeypatch.setattr("epiprior.matching.pair.detect_features", lambda *_: pytest.fail("features were detected"))
    ranking["matches"] = replace(ranking["matches"], image_sizes=((1024, 768), (1024, 768)))
    own = [detect_features(load_photograph(picture)) for picture in (LEFT, RIGHT)]
    options = {"estimator": estimator, "features1": own[0], "features2": own[1]}
    with_images = estimate_fundamental(LEFT, RIGHT, mode="standard", **options)
    assert with_images.status is Status.OK
    assert estimate_fundamental(None, None, mode="standard", **options).F.tobytes() == with_images.F.tobytes()
    estimate_fundamental(None, None, mode="cascade", rule=KEEP_NONE, **options)
    (call,) = ranking["calls"]
    assert call["features1"] is own[0]
    assert call["features2"] is own[1]


def test_without_image_or_size_a_threshold_has_no_meaning(ranking):
    ranked = ranked_of(ranking["matches"], ranking["matches"])
    refused(ImageError, "do not know its size", estimate_fundamental, None, None, ranked=ranked)
    sized = replace(ranking["matches"], image_sizes=((1024, 768), (1024, 768)))
    assert estimate_fundamental(None, None, ranked=ranked_of(sized, sized)).status is Status.OK


def test_a_poor_estimate_is_better_than_none_and_else_the_reason_is_of_the_ranked_matches(ranking):
    ranking["matches"] = make_pair(inliers=7, outliers=0).matches
    estimate = estimate_fundamental(LEFT, RIGHT, mode="cascade", rule=KEEP_NONE)
    assert len(ranking["calls"]) == 1
    assert estimate.status is Status.OK
    assert estimate.input == "snn"
    assert "first input" in estimate.seconds
    ranking["matches"] = make_pair(scene="plane", seed=2).matches
    estimate = estimate_fundamental(texture(), np.zeros((200, 300), np.uint8), mode="cascade")
    assert estimate.status in (Status.DEGENERATE, Status.NO_MODEL)
    assert estimate.input == "default"


def test_generalized_ransac_has_an_input_of_its_own(ranking):
    estimate = estimate_fundamental(LEFT, RIGHT, estimator="generalized-ransac", mode="standard")
    assert (estimate.status, estimate.input) == (Status.OK, "generalized")
    assert {"generalized matches", "estimator"} <= set(estimate.seconds)
    assert estimate_fundamental(LEFT, RIGHT, estimator="generalized-ransac", rule=KEEP_ALL).input == "snn"


@pytest.mark.parametrize(("rule", "taken"), [(KEEP_ALL, "snn"), (KEEP_NONE, "default")])
def test_the_rule_of_the_models_is_used(ranking, monkeypatch, rule, taken):
    monkeypatch.setattr(two_view, "load_cascade_rule", lambda: rule)
    assert estimate_fundamental(LEFT, RIGHT).input == taken
