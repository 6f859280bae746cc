"""Analysis of the method's parts, on tiny pictures with a model made by hand, and its tables on made-up rows."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from epiprior.estimators.handover import load_hand_overs
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.geometry import eight_point, normalise_fundamental, sampson_distance
from epiprior.presets import PAPER, FeatureSettings, find_preset
from epiprior.rank import rank_matches
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from epiprior_lab.analysis import analyse as analysis
from epiprior_lab.analysis import oracles as analysis_oracles
from epiprior_lab.analysis.analyse import AnalysisSettings
from epiprior_lab.analysis.records import Analysis, LimitRecord, VariantRecord
from epiprior_lab.analysis.variants import oriented_votes, propose, ranked_sets, reordered
from epiprior_lab.evaluation.records import RANKS, RankingRecord, RunRecord, Tables
from epiprior_lab.labels.ground_truth import TRUTH
from epiprior_lab.params import load_study
from epiprior_lab.report import analysis as page
from epiprior_lab.report import analysis_results
from synthetic import make_frames, make_pair

ESTIMATORS = {"estimator": "usac", "others": ("prosac",), "beyond": "magsac++"}
SETTINGS = AnalysisSettings(**ESTIMATORS, seeds=(0, 1), two_keypoint_counts=(12,), refined_hypotheses=5)
# The model made by hand knows the columns of `default` only.
PRESETS = {
    "default": replace(find_preset("default"), two_keypoint_count=20),
    "paper": replace(PAPER, two_keypoint_columns=find_preset("default").two_keypoint_columns, two_keypoint_count=20),
}


@pytest.fixture(scope="module")
def analysed(pairs, model, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EPIPRIOR_WORKERS", "1")
        patch.setattr(analysis, "load_model", lambda name: model)
        patch.setattr(analysis, "find_preset", PRESETS.__getitem__)
        common = {"settings": SETTINGS, "hand_overs": load_hand_overs(None), "labels": TRUTH, "files": ()}
        common["store"] = tmp_path_factory.mktemp("store")
        return analysis.analyse_pairs({"relief": pairs, "easy": pairs[1:]}, complete=("relief",), **common)


def of_group(found, name):
    return Analysis(**{part: table[table["group"] == name] for part, table in vars(found).items()})


@pytest.fixture(scope="module")
def ranked(pairs, model):
    return rank_matches(pairs[0].image1, pairs[0].image2, settings=PRESETS["default"], model=model)


def test_two_oriented_matches_give_eight_points():
    rng = np.random.default_rng(2)
    x, s, a = rng.uniform(0, 500, (2, 5, 2)), rng.uniform(2, 8, (2, 5)), rng.uniform(0, 6, (2, 5))
    frames = make_frames(*x, scale1=s[0], scale2=s[1], orientation1_rad=a[0], orientation2_rad=a[1])
    # Matches 3 and 1 are held by the most probable 2keypoint matches; 4 by none.
    pairs = TwoKeypointMatches(np.array([3, 1, 0]), np.array([3, 2, 2]), (), np.empty((3, 0), np.float32))
    votes = oriented_votes(frames, pairs, np.array([0.9, 0.8, 0.1]), replace(PRESETS["default"], two_keypoint_count=2))
    turns = a[:, None] + 2 * np.pi * np.arange(3)[:, None] / 3
    around = x[:, None] + 6 * s[:, None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    points = np.concatenate([x[:, None], around], axis=1)[:, :, [3, 1]].transpose(0, 2, 1, 3).reshape(2, 8, 2)
    (found,) = votes.matrices
    # The two have 8 points, which decide F exactly.
    np.testing.assert_allclose(normalise_fundamental(found), eight_point(*points), atol=1e-6)
    inside = sampson_distance(found, *x) < PRESETS["default"].vote_threshold
    np.testing.assert_array_equal(votes.sfm, inside)
    np.testing.assert_allclose(votes.weighted, np.where(inside, 0.9 * 0.8, 0), rtol=1e-6)


def test_variants_of_the_default_method_and_orders_by_one_measure(ranked, pairs, model):
    matches = ranked.sets[0]
    for ranking, column in (("sfm", "supporting_matrices"), ("2keypoint", "two_keypoint_probability")):
        alone = reordered(matches, ranking)
        values = getattr(alone, column)
        assert len(alone) == (getattr(matches, column) > 0).sum() > 50
        assert (np.diff(values) <= 0).all()
        np.testing.assert_allclose(alone.probability, values / (len(matches.rough_matrices) if ranking == "sfm" else 1))
    assert reordered(matches, "final") is matches
    images = (pairs[0].image1, pairs[0].image2)
    features = tuple(detect_features(load_photograph(image), FeatureSettings()) for image in images)
    proposals = propose(images, features, PRESETS["default"], model)
    whole = ranked_sets(proposals)[0]
    np.testing.assert_array_equal(whole.probability, ranked.sets[0].probability)
    np.testing.assert_array_equal(whole.rough_matrices, ranked.sets[0].rough_matrices)
    alone = ranked_sets(proposals, standard=False)[0]
    assert len(alone) == len(proposals.candidates[0].X) < len(whole)
    assert (alone.distance_ratio == 1).all()
    assert (alone.similarity_weight == 0).all()
    assert alone.supporting_matrices.max() == whole.supporting_matrices.max()
    assert len(ranked_sets(proposals, replace(PRESETS["default"], two_keypoint_count=10))[0].rough_matrices) == 45


def test_oracles_know_the_truth():
    pair = make_pair(inliers=120, outliers=300, noise_px=0.4, order=1.0)
    matches = replace(pair.matches, rough_matrices=np.stack([pair.F + 1e-3, pair.F, np.eye(3)]))
    labelled = analysis_oracles.Labelled(matches=matches, right=pair.right)
    told = analysis_oracles.labels_first(labelled)
    assert told.probability[:120].min() > 0.9 > 0.1 > told.probability[120:].max()
    np.testing.assert_array_equal(told.x1[:120], matches.x1[pair.right])
    assert len(labelled.right_one_to_one) == 120
    fit = analysis_oracles.fit_right(labelled)
    assert pair.error_px(fit) < 0.5
    assert pair.error_px(analysis_oracles.refine_on_all(fit, matches)) < 1.5
    assert analysis_oracles.score(fit, matches) > 2 * analysis_oracles.score(np.eye(3), matches)
    assert analysis_oracles.fit_right(replace(labelled, right=np.zeros_like(pair.right))) is None


def test_rows_and_rankings_of_a_pair(analysed, ranked, pairs):
    complete, easy = (of_group(analysed, name) for name in ("relief", "easy"))
    results = complete.variants
    assert (results.groupby(["pair_id", "experiment", "variant", "ranking", "estimator"]).size() == 2).all()
    found = {name: set(part["variant"]) for name, part in results.groupby("experiment")}
    steps = {"standard", "2keypoint", "sfm", "single F", "single F, refined", "paper", "default", "beyond"}
    assert found["steps"] == steps
    assert found["ablation"] == {"default", "one round", "X alone", "frames of SIFT", "oriented matches", "K_2kp 12"}
    relief = results[results["pair_id"] == "relief-0"].set_index(["experiment", "variant", "estimator", "ranking"])
    oracles = ("default", "prosac"), ("true labels", "prosac"), ("true labels", "magsac++"), ("right matches", "none")
    rows = [("oracle", *each, "final") for each in (*oracles, ("best rough F, refined on all", "none"))]
    rows += [("steps", "standard", "usac", "lowe"), ("steps", "default", "usac", "final")]
    for row in (*rows, ("ablation", "default", "usac", "sfm")):
        assert (relief.loc[row, "error_px"] < 1).all(), row
    assert 0.05 < relief.loc[("oracle", "best rough F", "none", "final"), "error_px"].iloc[0] < 10
    single, refined = (relief.loc[("steps", f"single F{how}", "none", "none"), "error_px"] for how in ("", ", refined"))
    assert single.iloc[0] > refined.iloc[0]
    assert relief.loc[("oracle", "right matches", "none", "final"), "score"].iloc[0] > 50
    blank = results[results["pair_id"] == "blank-0"]
    assert not (blank["status"] == "ok").any()
    assert blank["error_px"].isna().all()
    limits = complete.limits.set_index("pair_id")
    assert limits.loc["blank-0", "right_one_to_one"] == limits.loc["blank-0", "rough_matrices"] == 0
    row = limits.loc["relief-0"]
    assert 0 < row["good_rough_matrices"] <= row["rough_matrices"] == 20 * 19 // 2
    assert 100 < row["right_one_to_one_in_x"] <= row["right_one_to_one"]
    found = {name: set(part["variant"]) for name, part in easy.variants.groupby("experiment")}
    assert (found.keys(), found["ablation"]) == ({"steps", "ablation"}, {"default", "X alone"})
    assert set(easy.variants[easy.variants["estimator"] == "prosac"]["variant"]) == {"sfm", "paper"}
    assert easy.limits.empty
    table = of_group(analysed, "relief").precision
    table = table[table["pair_id"] == "relief-0"].set_index(["variant", "ranking"])
    final = ranked.sets[0].one_to_one()
    right = np.abs(final.x1[:, 1] - final.x2[:, 1]) < np.sqrt(2) * TRUTH.epipolar_px
    assert table.loc[("default", "final"), "precision_100"] == pytest.approx(right[:100].mean(), abs=0.03)
    assert table.loc[("X alone", "final"), "matches"] < table.loc[("default", "final"), "matches"]
    assert table.loc[("oriented matches", "sfm"), "precision_10"] > 0.5


def made_up(rates):
    """Return an analysis of 4 pairs in which each variant's first seeds succeed as told, by pair."""
    key = [{"group": "hard", "pair_id": f"p{i}", "scene": f"s{i}"} for i in range(4)]
    records = []
    for (experiment, variant, estimator), shares in rates.items():
        about = {"experiment": experiment, "variant": variant, "ranking": "final", "estimator": estimator}
        for (i, share), seed in itertools.product(enumerate(shares), range(5)):
            found = {"status": "ok", "error_px": 1.0 if seed < 5 * share else 50.0, "score": 10.0 + i}
            records.append(VariantRecord(**key[i], **about, **found, seed=seed))
    of_all = {"matches": 100, "right_one_to_one": 12, "rough_matrices": 200}
    of_each = [{"right_one_to_one_in_x": 6 + 4 * i, "good_rough_matrices": 10 * i} for i in range(4)]
    limits = [LimitRecord(**key[i], **of_all, **of_each[i]) for i in range(4)]
    return Analysis.from_records([*records, *limits])


RATES = {
    ("steps", "standard", "usac"): [0, 0, 0.2, 1],
    ("steps", "paper", "usac"): [0.2, 0, 0.6, 1],
    ("steps", "default", "usac"): [1, 0.4, 0, 0.4],
    ("oracle", "default", "usac"): [1, 0.4, 0, 0.4],
    ("oracle", "default", "beem"): [0, 0, 0, 1],
    ("oracle", "true labels", "beem"): [1, 1, 0, 1],
    ("oracle", "right matches", "none"): [1, 1, 1, 0],
    ("oracle", "best rough F, refined on all", "none"): [1, 1, 0, 0],
}


def test_where_successes_are_lost_their_references_and_what_the_pairs_allow():
    at = analysis_results.lost_table(made_up(RATES), (10.0, 0.5)).set_index(["threshold_px", "estimator"])
    assert list(at.index) == [(t, name) for t in (10.0, 0.5) for name in ("usac", "beem")]
    parts = ["chosen", "missed", "outscored", "hypothesis", "matches"]
    # The F chosen for p1 has no more support than the right ones: the score is 11 for all.
    assert at.loc[(10.0, "usac"), parts].tolist() == pytest.approx([1.8, 0.6, 0, 1.0, 0.6])
    assert at.loc[(10.0, "beem"), parts].tolist() == pytest.approx([1, 2, 0, 1, 0])
    assert at.loc[(0.5, "usac"), parts].tolist() == [0, 0, 0, 0, 4]
    higher = made_up(RATES)
    higher.variants.loc[higher.variants["variant"] == "default", "score"] = 12.0
    assert analysis_results.lost_table(higher, (10.0,)).loc[0, parts].tolist() == pytest.approx([1.8, 0, 0.6, 1.0, 0.6])
    # The fit to the right matches has much support and an error of 5 px: right below 10 px, wrong below 3 px.
    higher.variants.loc[higher.variants["variant"] == "right matches", ["score", "error_px"]] = [20.0, 5.0]
    lost = analysis_results.lost_table(higher, (10.0, 3.0)).set_index(["threshold_px", "estimator"])
    assert lost.loc[(10.0, "usac"), ["missed", "outscored"]].tolist() == pytest.approx([0.6, 0])
    assert lost.loc[(3.0, "usac"), ["missed", "outscored"]].tolist() == pytest.approx([0, 0.6])
    table = analysis_results.success_table(made_up(RATES), "usac", thresholds_px=(10.0,), draws=200, seed=0)
    with_beem = table[table["estimator"] == "beem"].set_index("variant")["difference"]
    assert with_beem[["default", "true labels"]].tolist() == pytest.approx([np.nan, 3 - 1], nan_ok=True)
    table = table[(table["estimator"] != "beem")].drop_duplicates("variant").set_index("variant")
    assert table.loc["standard", "successes"] == pytest.approx(1.2)
    found = table.loc[["standard", "paper", "default", "right matches"], "difference"].tolist()
    assert found == pytest.approx([1.2 - 1.8, np.nan, 0.0, 3 - 1.8], nan_ok=True)
    assert table.loc["default", "difference_low"] < 0 < table.loc["default", "difference_high"]
    assert analysis_results.reference_of(("steps", "sfm", "sfm", "beem"), "usac") == ("steps", "paper", "final", "beem")
    whole = ("ablation", "default", "sfm", "usac")
    assert analysis_results.reference_of(("ablation", "K_2kp 50", "sfm", "usac"), "usac") == whole
    row = analysis_results.limits_table(made_up(RATES)).iloc[0]
    assert row[["enough_8", "enough_15", "right_in_x", "good_rough"]].tolist() == pytest.approx([0.75, 0.25, 12, 0.075])


def differences(*rows):
    """Return rows of a table of successes of 8 pairs below 10 px: variant, ranking, difference and its interval."""
    names = ("variant", "ranking", "difference", "difference_low", "difference_high")
    at = {"group": "hard", "threshold_px": 10.0, "pairs": 8}
    return pd.DataFrame([at | dict(zip(names, row, strict=True)) for row in rows])


def test_the_page_says_where_the_whole_is_below_a_part_and_which_variants_differ():
    table = differences(
        ("standard", "lowe", 0.4, -1.0, 2.0), ("sfm", "sfm", 1.8, 0.4, 3.0), ("single F", "none", 1.0, 0.5, 2.0),
        ("2keypoint", "2keypoint", 4e-16, 0.0, 1.0), ("paper", "final", np.nan, np.nan, np.nan),
    )  # fmt: skip
    text = page._steps_read(table)
    assert "in the mean: *standard input (X_L)* on hard (10 px); *sfm alone* on hard (10 px)." in text
    assert text.endswith("excludes zero: sfm alone on hard below 10 px, +1.8 [+0.4, +3.0].")
    assert "single" not in text
    assert "Nor are they below" in page._steps_read(differences(("sfm", "sfm", -1.0, -2.0, 1.0)))
    table = differences(
        ("default", "final", np.nan, np.nan, np.nan), ("K_2kp 50", "final", -0.6, -1.2, -0.2),
        ("frames of SIFT", "final", 0.5, 4e-15, 1.0), ("K_2kp 50", "sfm", 0.5, -0.2, 1.0),
    )  # fmt: skip
    text = page._ablations_read(table)
    assert "Of the 2 differences ranked by final, this one has an interval that excludes zero: K_2kp 50 on hard" in text
    assert "Of the 1 differences ranked by sfm, none has" in text
    assert "With 8 pairs" in text


def evaluated():
    """Return what an evaluation of five pairs says, of which the numbers of right matches in X_L are known."""
    records = []
    unknown = ("confidence", "median_error_px", "distance", "rotation_deg", "translation_deg")
    for i, right in enumerate([30, 10, 50, 20, 40]):
        key = {"group": "f", "pair_id": f"p{i}", "scene": "s"}
        at = tuple(min(rank, right) if rank != 10 else 9 for rank in RANKS)
        about = {"right": right, "right_at": at, "features1": 9, "features2": 9, "average_precision": 0.3}
        for name, ranking in itertools.product(("paper", "default"), ("lowe", "blogs", "final")):
            count = 100 if ranking == "lowe" else 5000
            records.append(RankingRecord(**key, **about, input=name, ranking=ranking, matches=count))
        about = dict.fromkeys(unknown, np.nan) | {"support": 9, "matches": 9, "iterations": None}
        about |= {"geometry": "general", "status": "ok"}
        runs = itertools.product(("usac", "beem", "blogs"), ("standard", "paper", "default"), range(3))
        for estimator, name, seed in runs:
            error = 2.0 if name == "default" or (estimator == "beem" and seed < 2) else 30.0
            records.append(RunRecord(**key, **about, estimator=estimator, input=name, seed=seed, error_px=error))
    return Tables.from_records(records)


def test_table1_says_who_succeeds_on_pairs_that_are_chosen_by_rule():
    assert page.named_pairs(evaluated().rankings, "f", (0.0, 0.5, 1.0)) == ["p1", "p0", "p2"]
    made = page.table1_page(evaluated(), {"f": ["p0"]}, (0.5,), 10.0)
    rows = {row[0]: row[1:] for row in made.sections["f"][0].rows}
    assert (rows["matches"], rows["right of the first 10"]) == (["100", "5,000", "5,000", "5,000"], ["9"] * 4)
    assert rows["right of the first 100"] == ["30"] * 4
    assert rows["success"] == ["1 of 3: beem", "–", "1 of 3: beem", "3 of 3"]


def test_everything_is_written_twice_alike(analysed, pairs, tmp_path):
    analysed.write(tmp_path / "data")
    names = {"pair_id": {"p0": "relief-0", "p1": "blank-0"}, "group": {"f": "relief"}}
    found = Tables(**{name: table.replace(names) for name, table in vars(evaluated()).items()})
    params = load_study()
    own = {"table_quantiles": (0.0, 0.5), "refined_hypotheses": 5}
    own["estimators"] = ("usac", *params.analysis.estimators[1:])
    report = replace(params.report, bootstrap_draws=100)
    params = replace(params, analysis=replace(params.analysis, **own), report=report)
    written = []
    for out in (tmp_path / "one", tmp_path / "two"):
        page.write_analysis(Analysis.read([tmp_path / "data"]), found, {"relief": pairs}, out, params)
        written.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert written[0] == written[1]
    figures = {"table1.jpg", "steps.png", "ablations.png", "limits.png"}
    tables = {"successes.csv", "precision.csv", "lost.csv"}
    assert set(written[0]) == {"analysis.md", "index.html", "table1.md"} | figures | tables
    text = written[0]["analysis.md"].decode()
    assert "**relief**, 2 pairs" in text
    assert "two oriented matches | sfm" in text
    assert not re.search(r"\{|nan", text)
