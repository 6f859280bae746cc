"""Evaluation of pairs and the choice of hand-overs, on tiny pictures with a model made by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import epiprior.preprocess
from epiprior.baselines import snn_matches
from epiprior.errors import SettingsError
from epiprior.estimate import estimate_from_matches
from epiprior.features import FeatureSettings
from epiprior.geometry import sampson_distance
from epiprior.handover import HandOver, load_hand_overs
from epiprior.models import load_model
from epiprior.preprocess import rank_matches
from epiprior.presets import find_preset
from epiprior.types import MatchSet
from epiprior_lab import evaluation, hand_over_search, rankings
from epiprior_lab.datasets import Camera, Pair, read_pair_set
from epiprior_lab.ground_truth import LabelSettings
from epiprior_lab.params import HandOverParams
from epiprior_lab.seeds import child_seed
from pictures import relief_pair, save
from tiny_model import make_model

ESTIMATORS = ("usac", "magsac++")
INPUTS = ("standard", "snn", "default")
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """A pair of a relief, whose true epipolar lines are the rows, and a pair without texture."""
    root = tmp_path_factory.mktemp("sets") / "relief"
    (root / "images").mkdir(parents=True)
    (root / "control_points").mkdir()
    left, right = relief_pair()
    grey = np.full_like(left, 128)
    lines = ["pair_id,image1,image2,gt,scene,difficulty"]
    y, x = np.mgrid[10:350:9j, 10:400:9j]
    disparity = 25 + 12 * np.sin(x / 45) * np.cos(y / 40) + 8 * np.sin(y / 23)
    points = np.column_stack([(x + disparity).ravel(), y.ravel(), x.ravel(), y.ravel()])
    for name, images in (("relief-0", (left, right)), ("blank-0", (grey, grey))):
        save(root / "images" / f"{name}-1.png", images[0])
        save(root / "images" / f"{name}-2.png", images[1])
        lines.append(f"{name},images/{name}-1.png,images/{name}-2.png,control_points,{name[:-2]},")
        header = "x1,y1,x2,y2"
        np.savetxt(root / "control_points" / f"{name}.csv", points, delimiter=",", header=header, comments="")
    (root / "pairs.csv").write_text("\n".join(lines) + "\n")
    return read_pair_set(root).pairs


@pytest.fixture
def tiny_model(tmp_path, monkeypatch):
    model = load_model(make_model(tmp_path / "default"))
    monkeypatch.setattr(epiprior.preprocess, "load_model", lambda name: model)


@pytest.fixture
def hand_overs():
    return load_hand_overs(None)


def evaluate(pairs, hand_overs, **other):
    return evaluation.evaluate_pairs(
        pairs,
        family="relief",
        estimators=ESTIMATORS,
        inputs=INPUTS,
        seeds=SEEDS,
        hand_overs=hand_overs,
        labels=LabelSettings(),
        **other,
    )


def test_rows_of_a_pair(pairs, hand_overs, tiny_model, tmp_path):
    got = evaluate(pairs, hand_overs, store=tmp_path / "store")
    results = pd.DataFrame(got.results)
    runs = len(ESTIMATORS) * len(INPUTS) * len(SEEDS)
    assert results.groupby("pair_id").size().to_dict() == {"relief-0": runs, "blank-0": runs}
    assert not results.duplicated(["pair_id", "estimator", "input", "seed"]).any()

    blank = results[results["pair_id"] == "blank-0"]
    assert set(blank["status"]) == {"too_few_matches"}
    assert blank["error_px"].isna().all()
    assert (blank["support"] == 0).all()

    relief = results[results["pair_id"] == "relief-0"]
    assert set(relief["status"]) == {"ok"}
    assert (relief["error_px"] < 1).all()
    row = relief[(relief["estimator"] == "usac") & (relief["input"] == "snn") & (relief["seed"] == 1)].iloc[0]
    pair = pairs[0]
    sets = (snn_matches(pair.image1, pair.image2),)
    estimate = estimate_from_matches(
        sets, estimator="usac", seed=child_seed(1, "relief-0"), hand_over=hand_overs["usac"]["snn"]
    )
    distances = sampson_distance(estimate.F, *pair.control_points())
    assert row["error_px"] == pytest.approx(distances.mean(), rel=1e-12)
    assert row["median_error_px"] == pytest.approx(np.median(distances), rel=1e-12)
    assert row["support"] == estimate.support

    got.write(tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "results.csv")
    assert list(table.columns[:3]) == ["family", "pair_id", "scene"]
    assert table["error_px"].isna().sum() == runs
    evaluate(pairs, hand_overs, store=tmp_path / "store").write(tmp_path / "again")
    for name in ("results", "rankings", "ranking_curves", "roll", "calibration"):
        assert (tmp_path / "again" / f"{name}.csv").read_bytes() == (tmp_path / "out" / f"{name}.csv").read_bytes()


def test_rankings_roll_and_calibration_of_a_pair(pairs, hand_overs, tiny_model):
    got = evaluate(pairs[:1], hand_overs)
    ranked = rank_matches(pairs[0].image1, pairs[0].image2).sets[0]
    table = pd.DataFrame(got.rankings).set_index("ranking")
    assert tuple(table.index) == rankings.RANKINGS
    assert table.loc["final", "matches"] == len(ranked)
    right = np.abs(ranked.x1[:, 1] - ranked.x2[:, 1]) < np.sqrt(2) * LabelSettings().epipolar_px
    assert table.loc["final", "precision_100"] == pytest.approx(right[:100].mean(), abs=0.02)
    curves = pd.DataFrame(got.ranking_curves)
    at = curves[(curves["ranking"] == "final") & (curves["rank"] == 100)].iloc[0]
    assert at["right"] == 100 * table.loc["final", "precision_100"]
    bins = pd.DataFrame(got.calibration)
    assert bins["count"].sum() == len(ranked)
    assert bins["probability"].sum() == pytest.approx(ranked.probability.sum())
    assert bins["right"].sum() == table.loc["final", "right"]
    roll = pd.DataFrame(got.roll)
    assert roll["density"].sum() * 2 == pytest.approx(1, abs=0.01)
    assert roll["true_roll_deg"].isna().all()  # no cameras
    assert abs(roll["expected_roll_deg"].iloc[0]) < 5


def test_unknown_input_is_named(pairs):
    with pytest.raises(SettingsError, match="'lowe'"):
        evaluation.match_pair(pairs[0], ("lowe",))


def test_shared_features_change_nothing(pairs, tiny_model):
    got = evaluation.match_pair(pairs[0], ("standard", "default"))
    wanted = rank_matches(pairs[0].image1, pairs[0].image2).sets
    assert len(got.sets["default"]) == len(wanted)
    for a, b in zip(got.sets["default"], wanted, strict=True):
        np.testing.assert_array_equal(a.probability, b.probability)
        np.testing.assert_array_equal(a.x2, b.x2)
    assert got.pixel_factors == (1.0, 1.0)


def test_presets_detect_the_same_features():
    """Descriptors are normalised differently, but detection, which `match_pair` shares, is one."""
    settings = [find_preset(name).features for name in evaluation.PRESETS]
    assert {replace(s, root=True, centred=True) for s in settings} == {FeatureSettings()}


def match_set(n):
    zeros = np.zeros(n)
    xy = np.zeros((n, 2))
    index = np.arange(n)
    return MatchSet(
        x1=xy, x2=xy, scale1=zeros + 1, scale2=zeros + 1, orientation1_deg=zeros, orientation2_deg=zeros,
        feature1=index, feature2=index[::-1].copy(), probability=np.linspace(0.9, 0.1, n),
        supporting_matrices=np.zeros(n, np.int64), distance_ratio=zeros + 1, similarity_weight=zeros,
        similarity=zeros, two_keypoint_probability=zeros,
    )  # fmt: skip


def test_ranking_orders():
    matches = replace(
        match_set(5),
        distance_ratio=np.array([1, 0.7, 0.5, 1, 0.6]),
        similarity_weight=np.array([0, 0.2, 0, 0.4, 0.2]),
        two_keypoint_probability=np.array([0.1, 0, 0.9, 0.3, 0]),
        supporting_matrices=np.array([7, 7, 0, 9, 1]),
    )
    orders = {name: list(index) for name, index in rankings.ranking_orders(matches).items()}
    assert orders == {
        "lowe": [2, 4, 1],
        "blogs": [3, 1, 4],
        "2keypoint": [2, 3, 0],
        "sfm": [3, 0, 1, 4],
        "final": [0, 1, 2, 3, 4],
    }


@pytest.mark.parametrize("degrees", [-150, -30, 0, 37, 90])
def test_true_roll_turns_directions_of_the_image(degrees, tmp_path):
    turn = np.deg2rad(degrees)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    first = Camera(K=K, R=np.eye(3), t=np.zeros(3), width=640, height=480)
    second = Camera(K=K, R=R, t=np.array([0.1, 0, 0]), width=640, height=480)
    pair = Pair(pair_id="p", scene="s", image1=tmp_path, image2=tmp_path, camera1=first, camera2=second, difficulty="")
    # A direction to the right in image 1 points down in image 2 after 90 degrees: clockwise on the screen.
    ahead, right = np.array([[0.0, 0, 1e6], [1e3, 0, 1e6]])
    step = second.project(right[None])[0] - second.project(ahead[None])[0]
    assert np.degrees(np.arctan2(step[0, 1], step[0, 0])) == pytest.approx(degrees, abs=1e-6)
    assert rankings.true_roll_deg(pair) == pytest.approx(degrees)


PARAMS = HandOverParams(
    seeds=(0, 1),
    one_to_one=(True, False),
    top_k=(100, 300, 500, None),
    min_probability=(None, 0.2),
    max_distance_ratio=(0.7, 0.8, 0.9),
    threshold_px=(1.0, 1.5, 2.0),
    spread=(None, 0.1),
    collect=(True, False),
    refine=(True, False),
)


def no_matches(pair, inputs):
    return evaluation.PairMatches(sets=dict.fromkeys(inputs, ()), pixel_factors=(1.0, 1.0))


def made_up_error(matches, points, *, estimator, input_name, seed, hand_over: HandOver):
    """An error with one best hand-over per input; for prosac nothing matters."""
    if estimator == "prosac":
        return {"error_px": 5.0}
    penalty = 4 * abs(hand_over.threshold_px - 1.0)
    if input_name in evaluation.BASELINES:
        penalty += 80 * abs(hand_over.max_distance_ratio - 0.7) + (hand_over.top_k is not None)
    else:
        penalty += abs((hand_over.top_k or 1000) - 300) / 50 + 5 * (hand_over.min_probability is not None)
        penalty += 2 * (hand_over.spread is None) + hand_over.refine
    return {"error_px": 1.0 + penalty + hand_over.one_to_one}


def test_search_finds_the_best_hand_over(pairs, monkeypatch):
    monkeypatch.setattr(hand_over_search, "match_pair", no_matches)
    monkeypatch.setattr(hand_over_search, "estimate_row", made_up_error)
    monkeypatch.setattr(hand_over_search, "_effect", lambda matches, name, how: how)
    best, trials = hand_over_search.search_hand_overs(
        pairs, estimators=("usac", "prosac"), inputs=("standard", "default"), params=PARAMS
    )
    assert best["usac", "standard"].how == HandOver(
        one_to_one=False, max_distance_ratio=0.7, threshold_px=1.0, refine=False
    )
    assert best["usac", "default"].how == HandOver(
        one_to_one=False, top_k=300, spread=0.1, threshold_px=1.0, collect=True, refine=False
    )
    assert best["usac", "default"].score[0] == 4  # two pairs, two seeds
    # Where nothing matters, the first candidate stays, and the search is the same again.
    assert best["prosac", "default"].how.top_k == 100
    tried = [(t.estimator, t.input, t.how) for t in trials]
    assert len(tried) == len(set(tried))
    rows = [trial.row(trial is best[trial.estimator, trial.input]) for trial in trials]
    assert sum(row["chosen"] for row in rows) == 4
    chosen = hand_over_search.chosen_hand_overs(best)
    assert chosen["usac"]["standard"] == best["usac", "standard"].how


def test_score_breaks_ties_by_strict_successes_then_area():
    def trial(*errors):
        return hand_over_search.Trial(
            estimator="usac", input="snn", step="top_k", how=HandOver(), errors_px=np.array([errors])
        )

    assert trial(9.0, 9.0).score > trial(1.0, np.nan).score
    assert trial(9.0, 2.0).score > trial(4.0, 4.0).score
    assert trial(9.0, 2.0).score > trial(9.5, 2.0).score
    assert trial(10.0, np.nan).score == (0, 0, 0.0)


def test_paper_input_is_handed_over_as_printed():
    varied = {setting for setting, _ in hand_over_search.coordinates("paper", PARAMS)}
    assert varied.isdisjoint({"spread", "refine", "collect"})
    start = hand_over_search.starting_point("paper", PARAMS)
    assert not start.refine
    assert not start.collect


def test_equal_matches_are_estimated_once(pairs, monkeypatch):
    matches = evaluation.match_pair(pairs[0], ("standard", "snn"))
    how = HandOver(max_distance_ratio=0.9, threshold_px=1.0)
    candidates = [
        ("usac", "snn", how),
        ("usac", "snn", replace(how, max_distance_ratio=None)),  # above the ratio of all its matches
        ("usac", "snn", replace(how, top_k=10_000)),
        ("usac", "snn", replace(how, top_k=50)),
        ("usac", "snn", replace(how, threshold_px=2.0)),
        ("usac", "standard", how),
        ("magsac++", "snn", how),
    ]
    calls = []

    def counted(matches, points, **settings):
        calls.append(settings)
        return evaluation.estimate_row(matches, points, **settings)

    points = pairs[0].control_points()
    monkeypatch.setattr(hand_over_search, "estimate_row", counted)
    got = hand_over_search.candidate_errors("relief-0", points, matches, candidates, (0, 1))
    assert len(calls) == 5 * 2
    for (estimator, name, how), errors in zip(candidates, got, strict=True):
        for seed, error in enumerate(errors):
            row = evaluation.estimate_row(
                matches,
                points,
                estimator=estimator,
                input_name=name,
                seed=child_seed(seed, "relief-0"),
                hand_over=how,
            )
            assert row["error_px"] == error
