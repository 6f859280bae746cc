"""Why a match has its probability: against the ranking itself, and slow ways to the same numbers."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest

import epiprior
from calls import refused
from epiprior.errors import SettingsError
from epiprior.explain import explain_match
from epiprior.geometry import sampson_distance
from epiprior.presets import DEFAULT, SECOND_ROUND_COLUMNS
from epiprior.ranking.models import Classifier
from pictures import relief_pair, rotated
from tiny_model import MATCH_WEIGHTS, logistic

LEFT, RIGHT = relief_pair(300, 220)
SETTINGS = replace(DEFAULT, second_round=150)
AGAIN_WEIGHTS = {"probability": 3.0, "rank": -0.2}


@pytest.fixture(scope="module")
def model(model):
    """Two classifiers made by hand, and a third one for the second round."""
    session = onnxruntime.InferenceSession(logistic(SECOND_ROUND_COLUMNS, AGAIN_WEIGHTS, 5.0))
    return replace(model, second_round=Classifier(session, SECOND_ROUND_COLUMNS, 1.0, 0.0))


@pytest.fixture(scope="module")
def explain(model):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("epiprior.explain.load_model", lambda name: model)
        yield lambda *pair: explain_match(*pair, settings=SETTINGS)


@pytest.fixture(scope="module")
def ranked(model):
    return epiprior.rank_matches(LEFT, RIGHT, model=model, settings=SETTINGS).sets[0]


@pytest.fixture(scope="module")
def explained(ranked, explain):
    """The best match, one that was judged twice, one that was not; the best one of the images in the other order."""
    pairs = ((LEFT, RIGHT, 0), (LEFT, RIGHT, 130), (LEFT, RIGHT, len(ranked) - 1), (RIGHT, LEFT, 0))
    return [explain(*pair) for pair in pairs]


def column(judged, name):
    return next(c for c in judged.columns if c.name == name)


def test_the_match_is_that_row_of_the_ranking_in_either_order_of_the_images(ranked, explained):
    assert [len(e.rounds) for e in explained] == [2, 2, 1, 2]
    assert sorted(e.turned for e in (explained[0], explained[3])) == [False, True]
    for e, expected in zip(explained, (ranked, ranked, ranked, ranked.swapped()), strict=True):
        assert (e.match, e.set) == (e.row, 0)
        for name in ("x1", "x2", "probability", "rough_matrices"):
            np.testing.assert_array_equal(getattr(e.ranked, name), getattr(expected, name))
        assert e.probability == expected.probability[e.row] == pytest.approx(e.rounds[-1].probability, abs=1e-6)
        for name in ("supporting_matrices", "distance_ratio", "similarity_weight", "similarity"):
            assert column(e.rounds[-1], name).value == pytest.approx(getattr(expected, name)[e.row], rel=1e-6)
        assert [judged.judged for judged in e.rounds] == [len(ranked), 150][: len(e.rounds)]


def test_columns_stand_beside_those_of_other_matches(ranked, explained):
    for name in ("supporting_matrices", "distance_ratio"):
        found, values = column(explained[1].rounds[0], name), getattr(ranked, name)
        assert found.most_probable == pytest.approx(np.median(values[:100]))
        assert found.least_probable == pytest.approx(np.median(values[len(values) // 2 :]))
    rank = column(explained[0].rounds[1], "rank")  # of the 150 that were judged again, in their order
    assert rank.most_probable == pytest.approx(np.log1p(49.5), abs=0.01)
    assert rank.least_probable == pytest.approx(np.log1p(112), abs=0.01)


@pytest.mark.parametrize(("number", "weights"), [(0, MATCH_WEIGHTS), (1, AGAIN_WEIGHTS)])
def test_the_probability_with_another_value_is_the_classifiers(explained, number, weights):
    judged = explained[1].rounds[number]
    logit = np.log(judged.probability / (1 - judged.probability))
    for c in judged.columns:
        for value, said in ((c.most_probable, c.as_most), (c.least_probable, c.as_least)):
            expected = 1 / (1 + np.exp(-logit - weights.get(c.name, 0.0) * (value - c.value)))
            assert said == pytest.approx(expected, abs=1e-5)
    change = [max(abs(p - judged.probability) for p in (c.as_most, c.as_least)) for c in judged.decisive(99)]
    assert change == sorted(change, reverse=True)
    assert change[0] > 1e-4
    assert len(change) == len(judged.columns)


def test_what_holds_a_match_and_that_the_best_matrix_is_the_one_found_slowly(ranked, explained, explain):
    e = explained[0]
    assert len(set(e.partners)) == len(e.partners) > 0
    assert (np.diff(e.partner_probability) <= 0).all()
    assert e.partner_probability[0] == pytest.approx(ranked.two_keypoint_probability[0], rel=1e-6)
    back = explain(LEFT, RIGHT, int(e.partners[0]))
    assert 0 in back.partners
    assert back.partner_probability[list(back.partners).index(0)] == e.partner_probability[0]
    alone = ranked.one_to_one()
    for e in explained[:3]:
        own = ranked.take(slice(e.row, e.row + 1))
        others = alone.take((alone.feature1 != own.feature1) & (alone.feature2 != own.feature2))
        near = {k for k, F in enumerate(ranked.rough_matrices) if sampson_distance(F, own.x1, own.x2)[0] < 3}
        assert abs(len(near) - own.supporting_matrices[0]) <= 2 or not e.in_x
        inside = {k: sampson_distance(ranked.rough_matrices[k], others.x1, others.x2) < 3 for k in near}
        best = max(near, key=lambda k: others.probability[inside[k]].sum())
        assert e.best.index == best
        assert (ranked.rough_matrices[best] == e.best.F).all()
        assert e.best.inliers == inside[best].sum()
        assert e.best.probability_sum == pytest.approx(others.probability[inside[best]].sum())
        assert e.best.residual_px == pytest.approx(sampson_distance(e.best.F, own.x1, own.x2)[0], abs=1e-6)
        assert (e.self_made > 0) == bool(e.partner_voted.any())
        made = e.best.made_of.ravel()
        assert sampson_distance(e.best.F, ranked.x1[made], ranked.x2[made]).max() < 3


def test_rows_of_a_second_roll_hypothesis_follow_those_of_the_first_and_other_numbers_are_refused(model, explain):
    turned, _ = rotated(RIGHT, 37.0)
    sets = epiprior.rank_matches(LEFT, turned, model=model, settings=SETTINGS).sets
    found = explain(LEFT, turned, len(sets[0]) + 3)
    assert (found.set, found.row, found.ranked.roll_deg) == (1, 3, 0.0)
    assert found.probability == sets[1].probability[3]
    total = sum(map(len, sets))
    refused(SettingsError, f"match is {total}, but there are {total} matches", explain, LEFT, turned, total)
    refused(SettingsError, "match is -1", explain_match, "nothing.jpg", "nothing.jpg", -1)
