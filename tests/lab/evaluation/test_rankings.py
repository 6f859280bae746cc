"""Rankings of a pair against its truth: one list, walked one-to-one, of the most probable roll hypothesis."""

from dataclasses import replace

import numpy as np
import pytest

from epiprior.rank import rank_matches
from epiprior_lab.evaluation import inputs, rankings
from epiprior_lab.evaluation.records import RANKINGS, CalibrationRecord, PairRecord, RankingRecord, Tables
from epiprior_lab.labels.ground_truth import TRUTH
from synthetic import make_matches


def match_set(n, probability=None, **columns):
    """Matches of features 0, 1, ... with features n - 1, n - 2, ..., of falling probability."""
    known = {"feature2": np.arange(n)[::-1].copy(), "distance_ratio": np.ones(n)} | columns
    probability = np.linspace(0.9, 0.1, n) if probability is None else np.full(n, probability)
    return make_matches(np.zeros((n, 2)), np.zeros((n, 2)), probability, **known)


def test_orders_are_walked_one_to_one_and_the_hypothesis_with_the_most_probable_hundred_is_ranked():
    columns = {"distance_ratio": [1, 0.7, 0.5, 1, 0.6], "similarity_weight": [0, 0.2, 0, 0.4, 0.2]}
    columns |= {"two_keypoint_probability": [0.1, 0, 0.9, 0.3, 0], "supporting_matrices": [7, 7, 0, 9, 1]}
    matches = match_set(5, **{name: np.array(values) for name, values in columns.items()})
    orders = {name: list(index) for name, index in rankings.ranking_orders(matches).items()}
    assert tuple(orders) == RANKINGS
    wanted = {"lowe": [2, 4, 1], "blogs": [3, 1, 4], "2keypoint": [2, 3, 0], "sfm": [3, 0, 1, 4]}
    assert orders == wanted | {"final": [0, 1, 2, 3, 4]}
    matches = match_set(5, feature1=np.array([3, 3, 1, 2, 0]), feature2=np.array([0, 1, 1, 0, 4]))
    assert rankings.walked(matches, np.array([0, 1, 2, 3, 4])).tolist() == [0, 2, 4]
    assert rankings.walked(matches, np.array([4, 3, 2, 1, 0])).tolist() == [4, 3, 2]
    few, many = match_set(50, 0.9), match_set(300, 0.5)
    assert rankings.best_hypothesis((few, many)) is many
    assert rankings.best_hypothesis((many, few)) is many
    # A match whose feature was used does not count: here all but one.
    assert rankings.best_hypothesis((match_set(300, 0.99, feature1=np.zeros(300, np.int64)), many)) is many
    unranked = match_set(4, np.nan)
    assert rankings.best_hypothesis((unranked,)) is unranked


def test_records_of_a_pair_with_and_without_labels(pairs, tiny_model, tmp_path):
    [files] = inputs.store_matches(pairs[:1], ("standard", "snn", "generalized", "default"), tmp_path)
    found = rankings.pair_records(pair=pairs[0], matches=files, group="g", truth=TRUTH)
    assert [type(record) for record in found[:2]] == [PairRecord, RankingRecord]
    tables = Tables.from_records(found)
    (about,) = tables.pairs.to_dict("records")
    assert (about["group"], about["pair_id"], about["scene"]) == ("g", "relief-0", "relief")
    assert (about["labels"], about["points"], about["difficulty"]) == ("control_points", "control_points", "easy")
    assert (about["features1"], about["features2"]) == inputs.read_matches(files).features["standard"]
    assert {*zip(tables.rankings["features1"], tables.rankings["features2"], strict=True)} == {
        inputs.read_matches(files).features["snn"]
    }
    assert np.isnan(about["true_roll_deg"])  # no cameras
    assert abs((about["expected_roll_deg"] + 180) % 360 - 180) < 5

    def right(matches):  # the true lines are the rows
        return np.abs(matches.x1[:, 1] - matches.x2[:, 1]) < np.sqrt(2) * TRUTH.epipolar_px

    assert about["right_share"] == pytest.approx(right(inputs.read_matches(files).sets["standard"][0]).mean(), abs=0.01)
    table = tables.rankings.set_index(["input", "ranking"])
    assert [name for name, _ in table.index] == ["standard", "snn", "generalized", *["default"] * 5]
    assert [ranking for _, ranking in table.index] == ["final"] * 3 + list(RANKINGS)
    ranked = rankings.best_hypothesis(rank_matches(pairs[0].image1, pairs[0].image2).sets)
    final, single = table.loc[("default", "final")], ranked.one_to_one()
    assert (final["matches"], final["right"]) == (len(single), final["right_10000"])
    assert final["right_100"] == pytest.approx(right(single)[:100].sum(), abs=2)
    assert table.loc[("snn", "final"), "right_10"] == 10
    bins = tables.calibration
    assert isinstance(found[-1], CalibrationRecord)
    assert (bins["input"] == "default").all()
    assert (bins["bin"].tolist(), bins["count"].sum()) == (list(range(20)), len(ranked))
    assert bins["probability"].sum() == pytest.approx(ranked.probability.sum())
    settings = replace(TRUTH, one_plane=("relief-0",))  # which leaves no labels
    files = {"standard": files["standard"]}
    (about,) = rankings.pair_records(pair=pairs[0], matches=files, group="g", truth=settings)
    assert (about.labels, about.difficulty) == ("", "")
    assert np.isnan((about.right_share, about.expected_roll_deg)).all()  # nothing is ranked
