"""Evaluation of pairs and the choice of hand-overs, on tiny pictures with a model made by hand."""

from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import epiprior.matching.pair
import epiprior.rank
from epiprior.errors import SettingsError
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.detect import detect_features
from epiprior.geometry import sampson_distance
from epiprior.matching.baselines import snn_matches
from epiprior.presets import FeatureSettings, find_preset
from epiprior.rank import rank_matches
from epiprior.ranking.models import load_model
from epiprior.types import MatchSet, Status
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.source_graph import source_files
from epiprior_lab.evaluation import estimates as evaluation
from epiprior_lab.evaluation import rankings
from epiprior_lab.features import detection, matching
from epiprior_lab.labels.ground_truth import LabelSettings
from epiprior_lab.pairsets import Camera, Pair, read_pair_set
from epiprior_lab.params import HandOverParams, WeightedParams
from epiprior_lab.selection import hand_over_search
from pictures import relief_pair, save
from tiny_model import make_model

INPUTS = {"usac": ("standard", "snn", "default"), "magsac++": ("generalized", "default")}
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
    monkeypatch.setattr(epiprior.rank, "load_model", lambda name: model)


@pytest.fixture
def hand_overs():
    return load_hand_overs(None)


def evaluate(pairs, hand_overs, **other):
    return evaluation.evaluate_pairs(
        pairs,
        family="relief",
        inputs=INPUTS,
        seeds=SEEDS,
        hand_overs=hand_overs,
        labels=LabelSettings(),
        **other,
    )


def test_rows_of_a_pair(pairs, hand_overs, tiny_model, tmp_path):
    got = evaluate(pairs, hand_overs, store=tmp_path / "store")
    results = pd.DataFrame(got.results)
    runs = sum(len(names) for names in INPUTS.values()) * len(SEEDS)
    assert results.groupby("pair_id").size().to_dict() == {"relief-0": runs, "blank-0": runs}
    assert not results.duplicated(["pair_id", "estimator", "input", "seed"]).any()
    assert {e: tuple(dict.fromkeys(part["input"])) for e, part in results.groupby("estimator")} == INPUTS

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
    assert (row["support"], row["spread"]) == (estimate.support, estimate.spread)
    assert row["plausibility"] == estimate.plausibility > 0.5

    got.write(tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "results.csv")
    assert list(table.columns[:3]) == ["family", "pair_id", "scene"]
    assert table["error_px"].isna().sum() == runs
    evaluate(pairs, hand_overs, store=tmp_path / "store").write(tmp_path / "again")
    for name in ("results", "rankings", "ranking_curves", "roll", "calibration"):
        assert (tmp_path / "again" / f"{name}.csv").read_bytes() == (tmp_path / "out" / f"{name}.csv").read_bytes()


def test_errors_are_those_of_f_whatever_the_verdict_says(pairs, monkeypatch):
    matches = matching.match_pair(pairs[0], ("snn",))
    run = {"estimator": "usac", "input_name": "snn", "seed": 0, "hand_over": HandOver()}
    before = evaluation.estimate_row(matches, pairs[0].control_points(), **run)
    monkeypatch.setattr("epiprior.estimators.run.judge", lambda *_: (Status.DEGENERATE, "out of spite"))
    after = evaluation.estimate_row(matches, pairs[0].control_points(), **run)
    assert (before["status"], after["status"]) == ("ok", "degenerate")
    assert before["error_px"] == after["error_px"] < 1
    assert after["median_error_px"] == before["median_error_px"]


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


def test_a_changed_hand_over_leaves_other_estimators_as_they_are(pairs, hand_overs, tiny_model, tmp_path, monkeypatch):
    """What was computed is computed again only where something of it changed, matches included."""
    evaluate(pairs[:1], hand_overs, store=tmp_path)
    calls = []

    def counted(matches, points, **settings):
        calls.append((settings["estimator"], settings["input_name"]))
        return evaluation_row(matches, points, **settings)

    evaluation_row = evaluation.estimate_row
    monkeypatch.setattr(evaluation, "estimate_row", counted)
    monkeypatch.setattr(matching, "detect_pair", None)  # nothing is matched again
    changed = {**hand_overs, "usac": {**hand_overs["usac"], "snn": HandOver(threshold_px=2.5)}}
    evaluate(pairs[:1], changed, store=tmp_path)
    assert set(calls) == {("usac", name) for name in INPUTS["usac"]}
    calls.clear()
    unused = {**changed, "magsac++": {**hand_overs["magsac++"], "snn": HandOver(threshold_px=2.5)}}
    evaluate(pairs[:1], unused, store=tmp_path)
    assert not calls


def test_a_deterministic_estimator_runs_once(pairs, hand_overs, tiny_model, monkeypatch):
    seeds = []

    def made_up(matches, points, **settings):
        seeds.append(settings["seed"])
        return {"error_px": float(len(seeds))}

    monkeypatch.setattr(evaluation, "estimate_row", made_up)
    monkeypatch.setattr(evaluation, "is_deterministic", lambda name: name == "magsac++")
    results = pd.DataFrame(evaluate(pairs[:1], hand_overs).results)
    fixed = results[results["estimator"] == "magsac++"]
    assert fixed["seed"].tolist() == [0, 1] * 2
    assert fixed.groupby("input")["error_px"].nunique().tolist() == [1, 1]
    assert results[results["estimator"] == "usac"]["error_px"].is_unique
    assert len(seeds) == 3 * 2 + 2


def test_which_estimators_are_deterministic(monkeypatch):
    class Fixed:
        deterministic = True

    assert not evaluation.is_deterministic("usac")
    monkeypatch.setattr(evaluation, "find_estimator", lambda name: Fixed())
    assert evaluation.is_deterministic("anything")


def test_unknown_input_is_named(pairs):
    with pytest.raises(SettingsError, match="'lowe'"):
        matching.match_pair(pairs[0], ("lowe",))


def test_shared_features_and_files_change_nothing(pairs, tiny_model, tmp_path):
    [files] = matching.store_matches(pairs[:1], ("standard", "default"), tmp_path / "matches")
    got = files.only(("default",)).read()
    wanted = rank_matches(pairs[0].image1, pairs[0].image2).sets
    assert list(got.sets) == ["default"]
    assert len(got.sets["default"]) == len(wanted)
    for a, b in zip(got.sets["default"], wanted, strict=True):
        np.testing.assert_array_equal(a.probability, b.probability)
        np.testing.assert_array_equal(a.x2, b.x2)
        np.testing.assert_array_equal(a.rough_matrices, b.rough_matrices)
    assert got.pixel_factors == (1.0, 1.0)


def test_thresholds_of_large_images_are_meant_at_working_size(pairs, tmp_path):
    """An image of 1230 pixels is worked on at 1024; its F and errors are in its own pixels."""
    paths = []
    for k, path in enumerate((pairs[0].image1, pairs[0].image2)):
        image = cv2.resize(cv2.imread(str(path)), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
        paths.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(paths[-1]), image)
    assert max(image.shape) > FeatureSettings().max_image_size
    large = replace(pairs[0], image1=paths[0], image2=paths[1])
    matches = matching.match_pair(large, ("snn",))
    factor = max(image.shape) / FeatureSettings().max_image_size
    assert matches.pixel_factors == pytest.approx((factor, factor))
    how = HandOver(threshold_px=1.0)
    points = tuple(3 * x + 1 for x in pairs[0].control_points())
    row = evaluation.estimate_row(matches, points, estimator="usac", input_name="snn", seed=0, hand_over=how)
    assert row["error_px"] < 2
    without = replace(matches, pixel_factors=(1.0, 1.0))
    strict = evaluation.estimate_row(without, points, estimator="usac", input_name="snn", seed=0, hand_over=how)
    assert strict["support"] < row["support"]  # a pixel of the large image is less than a working pixel


def test_matches_do_not_depend_on_estimators():
    """So that a changed estimator leaves stored matches as they are."""
    files = source_files(Path(matching.__file__))
    assert not [file for file in files if file.parent.name == "estimators"]


def test_features_are_detected_once_for_all_inputs(pairs, tiny_model, monkeypatch):
    detected = []

    def counted(photograph, settings):
        detected.append(photograph)
        return detect_features(photograph, settings)

    wanted = {name: matching.match_pair(pairs[0], (name,)).sets[name] for name in ("snn", "generalized", "default")}
    monkeypatch.setattr(detection, "detect_features", counted)
    monkeypatch.setattr(epiprior.matching.pair, "detect_features", None)
    got = matching.match_pair(pairs[0], tuple(wanted)).sets
    assert len(detected) == 2
    for name, sets in wanted.items():
        for a, b in zip(got[name], sets, strict=True):
            for column in fields(a):
                np.testing.assert_array_equal(getattr(a, column.name), getattr(b, column.name))


def test_presets_detect_the_same_features():
    """Descriptors are normalised differently, but detection, which `match_pair` shares, is one."""
    settings = [find_preset(name).features for name in matching.PRESETS]
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
    max_distance_ratio=(0.7, 0.8, 0.9),
    top_k=(100, 300, 500, None),
    weighted=WeightedParams(estimators=("epiprior",), top_k=(300, 2000)),
    min_probability=(None, 0.2),
    threshold_px=(1.0, 1.5, 2.0),
    one_to_one=(True, False),
    refine=(True, False),
    collect=(True, False),
    spread=(None, 0.1),
)
SEARCHED = {"usac": ("standard", "default"), "prosac": ("standard", "default"), "epiprior": ("generalized", "default")}


def no_matches(pair, inputs):
    return matching.PairMatches(sets=dict.fromkeys(inputs, ()), pixel_factors=(1.0, 1.0))


def made_up_error(matches, points, *, estimator, input_name, seed, hand_over: HandOver):
    """An error with one best hand-over per input; for prosac nothing matters."""
    if estimator == "prosac":
        return {"error_px": 5.0}
    penalty = 4 * abs(hand_over.threshold_px - 1.0)
    if input_name == "standard":
        penalty += 80 * abs(hand_over.max_distance_ratio - 0.7) + (hand_over.top_k is not None)
    else:
        penalty += abs((hand_over.top_k or 1000) - 300) / 50 + 5 * (hand_over.min_probability is not None)
        penalty += 2 * (hand_over.spread is None) + hand_over.refine
    return {"error_px": 1.0 + penalty + hand_over.one_to_one}


def test_search_finds_the_best_hand_over(pairs, monkeypatch):
    monkeypatch.setattr(matching, "match_pair", no_matches)
    monkeypatch.setattr(hand_over_search, "estimate_row", made_up_error)
    monkeypatch.setattr(hand_over_search, "_effect", lambda matches, name, how: how)
    best, trials = hand_over_search.search_hand_overs(pairs, inputs=SEARCHED, params=PARAMS)
    assert best["usac", "standard"].how == HandOver(
        one_to_one=False, max_distance_ratio=0.7, threshold_px=1.0, refine=False
    )
    assert best["usac", "default"].how == HandOver(
        one_to_one=False, top_k=300, spread=0.1, threshold_px=1.0, collect=True, refine=False
    )
    assert best["usac", "default"].score[0] == 2 * 4  # two pairs, two seeds, both thresholds
    # Where nothing matters, the starting point stays.
    assert best["prosac", "default"].how == hand_over_search.starting_point("prosac", "default")
    tried = [(t.estimator, t.input, t.how) for t in trials]
    assert len(tried) == len(set(tried))
    rows = [trial.row(trial is best[trial.estimator, trial.input]) for trial in trials]
    assert sum(row["chosen"] for row in rows) == 6
    chosen = hand_over_search.chosen_hand_overs(best)
    assert {e: tuple(table) for e, table in chosen.items()} == SEARCHED
    assert chosen["usac"]["standard"] == best["usac", "standard"].how


def test_every_input_is_searched_by_what_matters_for_it():
    def varied(estimator, name):
        return dict(hand_over_search.coordinates(estimator, name, PARAMS))

    assert varied("epiprior", "default")["top_k"] == (300, 2000)
    assert varied("usac", "default")["top_k"] == PARAMS.top_k
    assert varied("generalized-ransac", "generalized")["top_k"] == (300, 2000)
    for name in ("standard", "snn"):
        assert {"max_distance_ratio", "threshold_px", "one_to_one", "refine", "collect"} == varied("usac", name).keys()


def test_score_counts_both_thresholds_alike_then_the_area():
    def trial(*errors):
        return hand_over_search.Trial(
            estimator="usac", input="snn", step="top_k", how=HandOver(), errors_px=np.array([errors])
        )

    assert trial(9.0, 9.0, 2.0).score > trial(1.0, np.nan, np.nan).score
    assert trial(1.0, np.nan).score[0] == trial(9.0, 9.0).score[0] == 2
    assert trial(9.0, 2.0).score > trial(4.0, 4.0).score
    assert trial(9.0, 2.0).score > trial(9.5, 2.0).score
    assert trial(10.0, np.nan).score == (0, 0.0)


def test_a_hand_over_is_left_only_for_gains_above_their_standard_error():
    def trial(errors, top_k=None):
        how = HandOver(top_k=top_k)
        return hand_over_search.Trial(
            estimator="usac", input="snn", step="top_k", how=how, errors_px=np.array(errors)[:, None]
        )

    known = trial([50.0] * 8 + [0.5] * 8)
    lucky = trial([0.5, 0.5, *[50.0] * 6, 50.0, *[0.5] * 7], top_k=100)  # two pairs won, one lost
    better = trial([0.5, 0.5, 0.5, *[50.0] * 5, *[0.5] * 8], top_k=300)
    best = trial([*[0.5] * 6, 50.0, 50.0, 50.0, *[0.5] * 7], top_k=500)
    gain = lucky._pair_scores() - known._pair_scores()
    assert 0 < gain.mean() < gain.std(ddof=1) / 4
    assert lucky.score > known.score
    assert not lucky.gains_on(known)
    assert not known.gains_on(known)
    assert hand_over_search.choose(known, [lucky]) is known
    assert hand_over_search.choose(known, [lucky, better]) is better
    assert hand_over_search.choose(known, [lucky, best, better]) is best
    assert trial([0.5]).gains_on(trial([2.0]))


def test_paper_input_is_handed_over_as_printed():
    varied = hand_over_search.coordinates("usac", "paper", PARAMS)
    assert {setting for setting, _ in varied}.isdisjoint({"spread", "refine", "collect"})
    start = hand_over_search.starting_point("usac", "paper")
    assert not start.refine
    assert not start.collect


def test_equal_matches_are_estimated_once(pairs, monkeypatch, tmp_path):
    [files] = matching.store_matches(pairs[:1], ("standard", "snn"), tmp_path)
    matches = files.read()
    how = HandOver(max_distance_ratio=0.9, threshold_px=1.0)
    candidates = [
        ("snn", how),
        ("snn", replace(how, max_distance_ratio=None)),  # above the ratio of all its matches
        ("snn", replace(how, top_k=10_000)),
        ("snn", replace(how, top_k=50)),
        ("snn", replace(how, threshold_px=2.0)),
        ("standard", how),
    ]
    calls = []

    def counted(matches, points, **settings):
        calls.append(settings)
        return evaluation.estimate_row(matches, points, **settings)

    points = pairs[0].control_points()
    monkeypatch.setattr(hand_over_search, "estimate_row", counted)
    got = hand_over_search.candidate_errors(
        pair=pairs[0], matches=files, estimator="usac", candidates=candidates, seeds=(0, 1)
    )
    assert len(calls) == 4 * 2
    for (name, how), errors in zip(candidates, got, strict=True):
        for seed, error in enumerate(errors):
            row = evaluation.estimate_row(
                matches,
                points,
                estimator="usac",
                input_name=name,
                seed=child_seed(seed, "relief-0"),
                hand_over=how,
            )
            assert row["error_px"] == error
    # What an earlier step found for the same matches, threshold and refinement is not run again either.
    calls.clear()
    again = hand_over_search.candidate_errors(
        pair=pairs[0],
        matches=files,
        estimator="usac",
        candidates=candidates,
        seeds=(0, 1),
        known={"snn": (replace(how, top_k=9_999), (11.0, np.nan))},
    )
    assert len(calls) == 3 * 2
    np.testing.assert_array_equal(again[:3], [[11.0, np.nan]] * 3)
    np.testing.assert_array_equal(again[3:], got[3:])


def test_a_step_of_the_search_knows_the_best_of_the_one_before(pairs, monkeypatch):
    told = []

    def candidate_errors(*, pair, matches, estimator, candidates, seeds, known):
        told.append((pair.pair_id, estimator, known))
        return np.array([[len(told) + len(str(how))] * len(seeds) for _, how in candidates], float)

    def map_tasks(function, tasks, **options):
        return [function(**task.payload) for task in tasks]

    monkeypatch.setattr(matching, "match_pair", no_matches)
    monkeypatch.setattr(hand_over_search, "candidate_errors", candidate_errors)
    monkeypatch.setattr(hand_over_search, "map_tasks", map_tasks)
    _, trials = hand_over_search.search_hand_overs(pairs, inputs={"usac": ("standard", "snn")}, params=PARAMS)
    first = [known for _, _, known in told[: len(pairs)]]
    assert first == [{}] * len(pairs)
    for number, (_, _, known) in enumerate(told[len(pairs) : 2 * len(pairs)]):
        assert set(known) == {"standard", "snn"}
        for name, (how, errors) in known.items():
            (trial,) = [t for t in trials if t.input == name and t.how == how]
            assert errors == tuple(trial.errors_px[number])
