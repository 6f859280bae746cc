"""Tables of the report: every number equals one that is counted here."""

import numpy as np
import pandas as pd
import pytest

from calls import refused
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.records import Tables, right_column
from epiprior_lab.evaluation.statistics import Interval, paired_bootstrap
from epiprior_lab.report import tables
from epiprior_lab.report.results import ReportError, Results
from synthetic_tables import APART, PHOTOGRAPH_INPUTS, SEEDS, SETS, STUDY_GROUPS, STUDY_INPUTS


def rows_of(results, table, group):
    """Rows of a family or set, of a difficulty, or of all that count."""
    if group in results.sets:
        return table[table["group"] == group]
    pairs = results.tables.pairs[~results.tables.pairs["group"].isin(APART)]
    pairs = pairs if group == "all" else pairs[pairs["difficulty"] == group]
    return table.merge(pairs[["group", "pair_id"]], on=["group", "pair_id"])


@pytest.fixture(params=["study", "photographs"])
def both(request):
    own = request.getfixturevalue(request.param)
    made, _ = request.getfixturevalue("study_report" if request.param == "study" else "photograph_report")
    return own.results, made, STUDY_INPUTS if request.param == "study" else PHOTOGRAPH_INPUTS


def test_groups(study, photographs):
    assert study.results.main == tuple(study.results.masks) == (*STUDY_GROUPS, "all")
    assert photographs.results.main == ("easy", "medium", "hard", "all")
    sizes = {name: int(member.sum()) for name, member in photographs.results.masks.items()}
    assert list(sizes.items()) == [("easy", 3), ("medium", 2), ("hard", 6), ("all", 12), *((name, 6) for name in SETS)]
    assert photographs.results.hard_pairs.sum() == 6
    assert photographs.results.inputs("usac") == ["standard", "snn", "adalam", "gms", "aliked", "default"]


@pytest.mark.parametrize("threshold", [10.0, 3.0])
def test_successes_equal_counts_by_hand(both, threshold):
    results, made, inputs = both
    table = made["successes"].set_index(["threshold_px", "group", "estimator", "input"])
    assert set(table.index.get_level_values("group")) == set(results.masks)
    for group in results.masks:
        rows = rows_of(results, results.tables.runs, group)
        for estimator, names in inputs.items():
            found, scenes = {}, {}
            for name in names:
                part = rows[(rows["estimator"] == estimator) & (rows["input"] == name)]
                right = part["error_px"] < threshold
                counts = right.groupby(part["seed"]).sum()
                by_pair = right.groupby([part["group"], part["scene"], part["pair_id"]]).mean()
                scenes[name] = by_pair.groupby(level=[0, 1]).mean().mean()
                row = table.loc[(threshold, group, estimator, name)]
                found[name] = row["successes"]
                assert row["successes"] == pytest.approx(counts.mean())
                assert row["successes_sd"] == pytest.approx(counts.std())
                assert row["successes_ok"] == pytest.approx((right & (part["status"] == "ok")).sum() / len(SEEDS))
                assert row["scene_share"] == pytest.approx(scenes[name])
                assert row["pairs"] == part.groupby(["group", "pair_id"]).ngroups
            row, base = table.loc[(threshold, group, estimator, "default")], names[0]
            for column, other in (("gain", base), ("snn_gain", "snn")):
                gain = found["default"] / found[other] - 1 if found[other] else np.inf * found["default"] or 0.0
                assert row[column] == pytest.approx(gain, nan_ok=True)
            assert row["gain_low"] <= row["gain"] <= row["gain_high"]
            assert row["scene_gain"] == pytest.approx(scenes["default"] - scenes[base], abs=1e-9)
            assert np.isnan(table.loc[(threshold, group, estimator, base)]["gain"])


def test_one_scene_has_no_interval_and_what_is_absent_is_named(photographs, study):
    keep = vars(photographs.results.tables).items()
    one = {name: table[table["group"] == "fox"].assign(scene="a").reset_index(drop=True) for name, table in keep}
    results = Results(Tables(**one), photographs.params)
    at = tables.success_table(results, (10.0,))
    at = at[(at["group"] == "fox") & (at["input"] == "default")]
    assert at[["gain", "scene_gain"]].notna().all(axis=None)
    assert at[["gain_low", "gain_high", "scene_gain_low", "scene_gain_high"]].isna().all(axis=None)
    assert tables.ranking_table(results)["gain_low"].isna().all()
    refused(ReportError, "no results of degensac, only of usac", tables.duel_table, study.results, "degensac", (10.0,))
    runs = study.results.tables.runs
    kept = runs[~((runs["estimator"] == "prosac") & (runs["input"] == "standard"))]
    without = Tables(**{**vars(study.results.tables), "runs": kept})
    with pytest.raises(ReportError, match="prosac: no input of standard, generalized"):
        Results(without, study.params).inputs("prosac")


def test_duels_are_paired(both):
    results, made, inputs = both
    table = made["duels"]
    assert set(table["estimator"]) == set(inputs) - {"epiprior"}
    row = table[(table["group"] == "all") & (table["input"] == "snn") & (table["threshold_px"] == 10.0)]
    row = row.set_index("estimator").loc["generalized-ransac"]
    runs = rows_of(results, results.tables.runs, "all")
    right = runs[runs["input"] == "snn"].assign(right=lambda t: t["error_px"] < 10.0)
    counts = right.groupby("estimator")["right"].sum() / len(SEEDS)
    assert row["champion"] == pytest.approx(counts["epiprior"])
    assert row["difference"] == pytest.approx(counts["epiprior"] - counts["generalized-ransac"])
    assert row["difference_low"] <= row["difference"] <= row["difference_high"]
    better, worse = table["difference_low"] > 1e-9, table["difference_high"] < -1e-9
    known = table["difference_low"].notna()
    assert (table["decided"] == np.where(better, "better", np.where(worse, "worse", "open")))[known].all()


def test_a_comparison_is_the_paired_bootstrap_of_its_pairs_and_touching_zero_but_for_rounding_decides_nothing(study):
    touching = [(4e-15, 0.2, "open"), (-0.2, -4e-15, "open"), (0.0, 0.2, "open")]
    for low, high, expected in (*touching, (1e-6, 0.2, "better"), (-0.2, -1e-6, "worse")):
        interval = Interval(value=(low + high) / 2, low=low, high=high)
        assert tables.decided(interval) == expected
        cells = study.results.interval("x", interval, study.results.masks["all"], 40.0)
        assert (cells["x_low"], cells["x_high"]) == tuple(0.0 if abs(end) < 1e-9 else 40 * end for end in (low, high))
    results = study.results
    a, b = (results.errors.of("usac", name, 10.0) for name in ("standard", "default"))
    mask = results.masks["open"]
    found = results.compare(a, b, mask, "draw")
    scenes = [scene for scene in results.scenes if scene.startswith("open/")]
    seed = child_seed(study.params.seed, "draw")
    assert found == paired_bootstrap(a[mask], b[mask], draws=study.params.bootstrap_draws, seed=seed, groups=scenes)
    assert found.difference.value == pytest.approx(b[mask].mean() - a[mask].mean())


def test_poses_and_distances_count_only_pairs_that_have_them(photographs, photograph_report):
    table = photograph_report[0]["geometry"].set_index(["group", "estimator", "input"])
    row = table.loc[("all", "usac", "default")]
    assert row["cameras"] == 6  # fox; strecha has none here, scannet15 is apart
    assert row["true_F"] == 11
    runs = photographs.results.tables.runs
    part = runs[(runs["estimator"] == "usac") & (runs["input"] == "default")]
    fox = part[part["group"] == "fox"]
    angle = fox[["rotation_deg", "translation_deg"]].max(axis=1).fillna(np.inf)
    assert row["auc_10"] == pytest.approx(np.clip(1 - angle / 10, 0, 1).mean())
    wrong = (fox["error_px"] < 10) & (angle > 20)
    assert row[["posed_successes", "wrong_poses"]].tolist() == [(fox["error_px"] < 10).sum(), wrong.sum()]
    assert np.isnan(table.loc[("strecha", "usac", "default")]["auc_5"])
    pairs = photographs.results.tables.pairs[["group", "pair_id", "difficulty"]]
    labelled = rows_of(photographs.results, part, "all").merge(pairs[pairs["difficulty"] != ""])
    assert row["distance_recall"] == pytest.approx((labelled["distance"] < 0.05).mean())


def test_rankings_calibration_statuses_and_the_cascade_equal_counts_by_hand(both):
    results, made, _ = both
    table = made["rankings"].set_index(["group", "input", "ranking"])
    part = rows_of(results, results.tables.rankings, "all")
    means = (part[right_column(100)] / 100).groupby([part["input"], part["ranking"]]).mean()
    for name, ranking in means.index:
        row = table.loc[("all", name, ranking)]
        assert row["precision_100"] == pytest.approx(means[name, ranking])
        if (name, ranking) != ("standard", "final"):
            assert row["gain"] == pytest.approx(means[name, ranking] - means["standard", "final"], abs=1e-9)
            assert row["gain_low"] <= row["gain"] <= row["gain_high"]
    ours = part[(part["input"] == "default") & (part["ranking"] == "final")]
    row = table.loc[("all", "default", "final")]
    assert (row["pairs"], row["enough"]) == (len(ours), (ours["right"] >= 15).mean())
    by_scene = (ours[right_column(10)] / 10).groupby([ours["group"], ours["scene"]]).mean().mean()
    assert row["scene_precision_10"] == pytest.approx(by_scene)
    row = made["calibration"].set_index(["group", "input"]).loc[("all", "default")]
    part = rows_of(results, results.tables.calibration, "all")
    sums = part[part["input"] == "default"].groupby("bin")[["count", "right", "probability", "squared_error"]].sum()
    gaps = (sums["probability"] - sums["right"]).abs()
    assert row["expected_calibration_error"] == pytest.approx(gaps.sum() / sums["count"].sum())
    assert row["brier_score"] == pytest.approx(sums["squared_error"].sum() / sums["count"].sum())
    assert row["lowest_share"] == pytest.approx(sums["count"][0] / sums["count"].sum())
    assert row["upper_error"] == pytest.approx(gaps[1:].sum() / sums["count"][1:].sum())
    k = (gaps / sums["count"]).idxmax()
    assert row["gap_right"] == pytest.approx(sums["right"][k] / sums["count"][k])
    assert row["top_stated"] == pytest.approx(sums["probability"].iloc[-1] / sums["count"].iloc[-1])
    table = made["statuses"].set_index(["group", "input"])
    runs = rows_of(results, results.tables.runs, "all")
    for name in ("snn", "default", "all"):
        part = runs if name == "all" else runs[runs["input"] == name]
        right, has_F = part["error_px"] < 10, part["error_px"].notna()
        row = table.loc[("all", name)]
        assert row[["runs", "without_F", "right"]].tolist() == [len(part), (~has_F).sum(), right.sum()]
        assert row["wrong_degenerate"] == (has_F & ~right & (part["status"] == "degenerate")).sum()
        turned = (right & part["status"].isin(["no_model", "degenerate"])).sum()
        assert row["right_turned_down"] == pytest.approx(turned / right.sum())
    assert set(made["cascade"]["estimator"]) >= {"usac", "epiprior"}
    assert "magsac++" not in set(made["cascade"]["estimator"])  # of the photographs' runs, but not as the library does
    row = made["cascade"].set_index(["group", "estimator", "threshold_px"]).loc[("all", "usac", 10.0)]
    rows = rows_of(results, results.tables.runs, "all")
    rows = rows[rows["estimator"] == "usac"].assign(error=lambda t: t["error_px"].fillna(np.inf))
    wide = {name: part.set_index(["group", "pair_id", "seed"]) for name, part in rows.groupby("input")}
    # Made-up runs have a confidence of 0.97: the rule keeps whatever is ok, so that nothing is there to fall back on.
    kept = wide["snn"]["status"] == "ok"
    error = wide["snn"]["error"].where(kept, wide["default"]["error"])
    assert row["cascade"] == pytest.approx((error < 10).sum() / len(SEEDS))
    assert row["preprocessed"] == pytest.approx(1 - kept.mean())
    assert row["lost"] == pytest.approx(((wide["default"]["error"] < 10) & ~(error < 10)).sum() / len(SEEDS))
    assert row["change"] == pytest.approx(row["cascade"] - row["always"], abs=1e-9)


def test_limits_equal_counts_by_hand(photographs, photograph_report):
    table = photograph_report[0]["limits"].set_index("group")
    rows = rows_of(photographs.results, photographs.results.tables.runs, "hard")
    solved = rows.assign(right=rows["error_px"] < 10).groupby(["pair_id", "estimator", "input"])["right"].mean() > 0.5
    own = solved.xs(("epiprior", "default"), level=("estimator", "input"))
    failing = list(own.index[~own])
    assert list(table.index) == ["all", "fox"]  # no other set has hard pairs that count
    assert table.loc["all", ["pairs", "failing"]].tolist() == [6, len(failing)]
    by = solved[solved.index.get_level_values("pair_id").isin(failing)].reset_index()
    by = by[by["right"]]
    champion, ours = by["estimator"] == "epiprior", by["input"] == "default"
    expected = [part["pair_id"].nunique() for part in (by[champion & ~ours], by[~champion & ours], by)]
    assert table.loc["all", ["other_input", "other_estimator", "anyone"]].tolist() == expected


def test_sets_that_are_absent_or_apart_and_every_pair_are_in_their_tables(photograph_report, photographs):
    table = photograph_report[0]["sets"].set_index("group")
    assert list(table.index[:3]) == ["zubud1", "zubud2", "blogs"]
    assert table.loc["zubud1", ["state", "pairs"]].tolist() == ["not present", 137]
    assert table.loc["scannet15", "state"] == "apart"
    assert table.loc["strecha", ["easy", "medium", "hard", "unlabelled"]].tolist() == [3, 2, 0, 1]
    assert table.loc["strecha", "labels"] == "control_points + none"
    table = pd.read_csv(photograph_report[1] / "tables" / "pairs.csv", dtype={"pair_id": str, "scene": str})
    assert len(table) == len(SETS) * 6 * sum(map(len, PHOTOGRAPH_INPUTS.values()))
    row = table[(table["group"] == "fox") & (table["pair_id"] == "0003") & (table["input"] == "snn")].iloc[0]
    assert row["scene"] == "01"
    runs = photographs.results.tables.runs
    runs = runs[(runs["group"] == "fox") & (runs["pair_id"] == "0003") & (runs["input"] == "snn")]
    runs = runs[runs["estimator"] == row["estimator"]].set_index("seed")["error_px"]
    for seed in SEEDS:
        assert row[f"error_px_{seed}"] == pytest.approx(runs[seed], rel=1e-4, nan_ok=True)
    assert row["found"] == runs.notna().sum()


def test_classifiers_by_scene_and_by_row(study, study_report):
    table = study_report[0]["classifiers"].set_index(["preset", "target", "family", "metric"])
    row = table.loc[("default", "match", "svm", "accuracy")]
    assert (row["grouped"], row["ungrouped"]) == (pytest.approx(0.6), pytest.approx(0.68))
    assert row["grouped_sd"] == pytest.approx(np.std([0, 0.01, 0.02, 0.03], ddof=1))
