"""Rules of the cascade: what they keep and lose, how they are learnt, and what is reported."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from epiprior.cascade import CascadeRule
from epiprior.errors import SettingsError
from epiprior_lab import cascade_rule
from epiprior_lab.cascade_rule import (
    NEVER,
    candidate_rules,
    cascade_errors,
    kept_runs,
    learn_rule,
    lost_runs,
    paired_runs,
    trade_off,
)
from epiprior_lab.params import CascadeParams
from epiprior_lab.reports.cascade_figure import cascade_figure
from epiprior_lab.reports.cascade_tables import ALL, cascade_markdown, cascade_seconds, cascade_table
from epiprior_lab.reports.study import ReportError
from epiprior_lab.stages import cascade as stage

PARAMS = CascadeParams(
    seeds=(0,), tolerance=0.01, min_support=(0, 50, 100, 200), min_inlier_ratio=(0.0, 0.25, 0.5, 0.75)
)
INF = float("inf")


def runs_of(rows, estimator="usac"):
    """Rows are (scene, support, matches, error without, error with)."""
    columns = ["scene", "support", "matches", "without_px", "with_px"]
    table = pd.DataFrame(rows, columns=columns)
    table["status"] = np.where(np.isinf(table["without_px"]), "no_model", "ok")
    table["with_status"] = np.where(np.isinf(table["with_px"]), "no_model", "ok")
    table["pair_id"] = [f"pair-{i}" for i in range(len(table))]
    return table.assign(estimator=estimator, family="open", seed=0)


def test_runs_are_paired_and_other_inputs_left_out():
    def row(pair, name, seed, status, error):
        return {
            "family": "open", "pair_id": pair, "scene": "s", "estimator": "usac", "input": name, "seed": seed,
            "status": status, "support": 40 if name == "standard" else 90, "matches": 80, "error_px": error,
        }  # fmt: skip

    rows = [
        row("b", "default", 1, "ok", 4.0),
        row("b", "standard", 1, "degenerate", 3.0),
        row("b", "snn", 1, "ok", 9.0),
        row("b", "standard", 0, "ok", 2.0),
        row("b", "default", 0, "no_model", np.nan),
        row("a", "generalized", 0, "ok", 5.0),
        row("a", "default", 0, "ok", 6.0),
    ]
    got = paired_runs(pd.DataFrame(rows)).set_index(["pair_id", "seed"])
    assert got["without_px"].to_dict() == {("b", 1): 3.0, ("b", 0): 2.0, ("a", 0): 5.0}  # whatever the verdict says
    assert got["with_px"].to_dict() == {("b", 1): 4.0, ("b", 0): INF, ("a", 0): 6.0}
    assert got["with_status"].to_dict() == {("b", 1): "ok", ("b", 0): "no_model", ("a", 0): "ok"}
    assert got["support"].to_dict() == {("b", 1): 40, ("b", 0): 40, ("a", 0): 90}
    with pytest.raises(pd.errors.MergeError):
        paired_runs(pd.DataFrame([*rows, rows[0]]))


def test_a_cascade_takes_one_or_the_other_and_falls_back():
    runs = runs_of(
        [
            ("a", 120, 200, 1.0, 2.0),  # kept
            ("b", 20, 200, 50.0, 2.0),  # preprocessed
            ("c", 20, 200, 3.0, INF),  # preprocessed in vain: what was there is better than nothing
            ("d", 0, 200, INF, INF),
            ("e", 120, 200, 30.0, 1.0),  # kept, alas
        ]
    )
    rule = CascadeRule(min_support=50, min_inlier_ratio=0.5)
    kept = kept_runs(runs, [rule, NEVER])
    assert kept.tolist() == [[True, False, False, False, True], [False] * 5]
    assert cascade_errors(runs, kept[0]).tolist() == [1.0, 2.0, 3.0, INF, 30.0]
    assert lost_runs(runs, kept, 10.0).tolist() == [[False, False, False, False, True], [False] * 5]
    assert lost_runs(runs, kept, 1.5)[0].tolist() == [False, False, False, False, True]


def test_a_cascade_trusts_the_verdict_even_where_it_is_wrong():
    runs = runs_of([("a", 20, 200, 50.0, 2.0), ("b", 20, 200, 50.0, 2.0)])
    runs["with_status"] = "degenerate"
    runs.loc[1, "status"] = "degenerate"
    assert cascade_errors(runs, np.array([False, False])).tolist() == [50.0, 2.0]


def test_candidates_go_from_never_to_always():
    rules = candidate_rules(PARAMS)
    assert rules[0] == NEVER
    assert rules[1] == CascadeRule(min_support=200, min_inlier_ratio=0.75)
    assert rules[-1] == CascadeRule(min_support=0, min_inlier_ratio=0.0)
    assert len(set(rules)) == 17


def many_runs(n=60, bad_support=80, seed=0):
    """Right answers have 150 to 400 inliers and a high share; wrong ones fewer than `bad_support`."""
    rng = np.random.default_rng(seed)
    right = rng.random(n) < 0.5
    support = np.where(right, rng.integers(150, 400, n), rng.integers(8, bad_support, n))
    matches = np.where(right, support * 1.2, support * 5).astype(int)
    without = np.where(right, 0.5, 40.0)
    return runs_of(list(zip([f"s{i}" for i in range(n)], support, matches, without, np.full(n, 0.7), strict=True)))


def test_the_learnt_rule_tells_right_from_wrong_and_is_strict():
    runs = many_runs()
    found = learn_rule(runs, PARAMS, (10.0, 3.0))
    right = runs["without_px"] < 10
    assert found.preprocessed == pytest.approx(1 - right.mean())
    assert (found.lost, found.held_out_lost) == (0.0, 0.0)
    # Supports of 50 and lower shares would do as well on these runs.
    assert found.rule == CascadeRule(min_support=100, min_inlier_ratio=0.75)
    assert found.held_out_preprocessed == pytest.approx(found.preprocessed, abs=0.1)


def test_the_tolerance_holds_at_every_threshold_and_wins_buy_nothing():
    rows = [("a", 300, 310, 1.0, 1.0)] * 97 + [("b", 250, 260, 5.0, 1.0)] * 3
    runs = runs_of([(f"{scene}{i}", *rest) for i, (scene, *rest) in enumerate(rows)])
    loose, both = (learn_rule(runs, PARAMS, thresholds) for thresholds in ((10.0,), (10.0, 3.0)))
    assert (loose.preprocessed, both.preprocessed) == (0.0, 1.0)
    assert both.rule == NEVER
    wins = runs_of([(f"w{i}", 300, 310, 1.0, 50.0) for i in range(50)])
    won = pd.concat([runs, wins], ignore_index=True)
    assert learn_rule(won, PARAMS, (10.0, 3.0)).rule == NEVER
    assert learn_rule(won, replace(PARAMS, tolerance=0.03), (10.0, 3.0)).preprocessed == 0.0


def test_a_rule_has_a_margin_in_both_values():
    """A share of 0.5 and a support of 100 part right from wrong, but the wrong ones are just below."""
    right = [(f"r{i}", 250, 260, 1.0, 1.0) for i in range(10)] + [(f"q{i}", 110, 140, 1.0, 1.0) for i in range(10)]
    by_support = runs_of([*right, ("w", 99, 110, 50.0, 1.0)])
    (kept,) = kept_runs(by_support, [CascadeRule(min_support=100, min_inlier_ratio=0.75)])
    assert not lost_runs(by_support, kept, 10.0).any()
    assert kept.sum() == 20
    found = learn_rule(by_support, PARAMS, (10.0,))
    assert found.rule == CascadeRule(min_support=200, min_inlier_ratio=0.75)
    assert found.preprocessed == pytest.approx(11 / 21)
    by_share = runs_of([*right, ("w", 190, 400, 50.0, 1.0)])
    assert learn_rule(by_share, PARAMS, (10.0,)).rule == CascadeRule(min_support=100, min_inlier_ratio=0.75)


def test_held_out_shares_show_a_rule_that_one_scene_decides():
    """The only wrong answer with high support: without its scene, the rule would keep it."""
    runs = runs_of(
        [(f"s{i}", 250, 300, 1.0, 1.0) for i in range(30)]
        + [(f"t{i}", 120, 300, 1.0, 1.0) for i in range(30)]
        + [("bad", 120, 300, 90.0, 1.0)]
    )
    found = learn_rule(runs, PARAMS, (10.0,))
    assert found.lost == 0.0
    assert found.held_out_lost == pytest.approx(1 / 61)
    assert found.rule.min_support == 200 or found.rule.min_inlier_ratio > 0.4


def test_the_trade_off_falls_from_one_end_to_the_other():
    runs = many_runs(bad_support=260, seed=2)
    front = trade_off(runs, PARAMS, 10.0)
    assert (np.diff(front["preprocessed"]) < 0).all()
    assert (np.diff(front["lost"]) > 0).all()
    assert front["lost"].iloc[0] == 0
    kept = kept_runs(runs, candidate_rules(PARAMS))
    lost = lost_runs(runs, kept, 10.0).mean(axis=1)
    for share, loss in zip(1 - kept.mean(axis=1), lost, strict=True):
        assert ((front["preprocessed"] <= share + 1e-12) & (front["lost"] <= loss + 1e-12)).any()


@pytest.mark.parametrize(
    "bad", [{"tolerance": 1.5}, {"min_support": (-1,)}, {"min_inlier_ratio": (0.5, 0.5)}, {"seeds": ()}]
)
def test_bad_parameters_are_named(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        replace(PARAMS, **bad)


@pytest.fixture(scope="module")
def study():
    splits = {
        split: pd.concat(
            [
                many_runs(bad_support=150, seed=seed).assign(estimator=name, family=family)
                for name in ("usac", "prosac")
                for family in ("open", "rolled")
            ],
            ignore_index=True,
        )
        for seed, split in enumerate(("validation", "test"))
    }
    splits["test"].loc[7, ["without_px", "with_px", "support", "matches"]] = [60.0, 1.0, 399, 400]
    valid = splits["validation"]
    learnt = {name: learn_rule(valid[valid["estimator"] == name], PARAMS, (10.0, 3.0)) for name in ("usac", "prosac")}
    return splits, learnt


def test_the_table_counts_successes(study):
    splits, learnt = study
    table = cascade_table(splits, learnt, thresholds_px=(10.0, 3.0), draws=200, seed=1)
    assert len(table) == 2 * 2 * 3 * 2
    by = table.set_index(["split", "estimator", "family", "threshold_px"])
    row = by.loc[("test", "usac", "open", 10.0)]
    part = splits["test"].query("estimator == 'usac' and family == 'open'")
    assert (row["pairs"], row["always"]) == (60, 60)
    assert row["without"] == (part["without_px"] < 10).sum()
    assert (row["lost"], row["won"], row["cascade"], row["change"]) == (1, 0, 59, -1)
    assert row["change_low"] < 0 <= row["change_high"]
    (kept,) = kept_runs(part, [learnt["usac"].rule])
    assert row["preprocessed"] == pytest.approx(1 - kept.mean())
    assert by.loc[("validation", "prosac", ALL, 3.0), "lost"] == 0
    again = cascade_table(splits, learnt, thresholds_px=(10.0, 3.0), draws=200, seed=1)
    pd.testing.assert_frame_equal(table, again)


def test_time_is_saved_where_little_is_preprocessed():
    overhead = pd.DataFrame(
        [
            ("default", "open", "usac", 1.0, 4.0),
            ("paper", "open", "usac", 1.0, 9.0),
            ("default", "easy", "usac", 1.0, 4.0),
        ],
        columns=["preset", "family", "estimator", "seconds_without", "seconds_with"],
    )
    shares = pd.DataFrame(
        [("test", "open", 0.9), ("test", "easy", 0.25), ("test", ALL, 0.5), ("validation", "open", 0.0)],
        columns=["split", "family", "preprocessed"],
    ).assign(estimator="usac")
    both = pd.concat([shares.assign(threshold_px=t) for t in (10.0, 3.0)])
    got = cascade_seconds(overhead, both).set_index("family")
    assert got["seconds_always"].to_dict() == {"open": 4.0, "easy": 4.0}
    assert got["seconds_cascade"].to_dict() == pytest.approx({"open": 4.6, "easy": 2.0})
    assert got["saved"].to_dict() == pytest.approx({"open": -0.15, "easy": 0.5})


def test_the_text_and_the_figure(study, tmp_path):
    splits, learnt = study
    table = cascade_table(splits, learnt, thresholds_px=(10.0,), draws=200, seed=1)
    never = {**learnt, "prosac": replace(learnt["prosac"], rule=NEVER)}
    text = cascade_markdown(table, never, PARAMS.tolerance)
    assert f"| usac | {learnt['usac'].rule.min_support} | {learnt['usac'].rule.min_inlier_ratio:g} |" in text
    assert "| prosac | - | - |" in text
    assert "at most 1 % of" in text
    assert "## Test pairs below 10 px: all families (120 pairs)" in text
    row = next(line for line in text.splitlines() if line.startswith("| usac") and "[" in line)
    assert " -1.0 [" in row
    for name in "ab":
        cascade_figure(splits, learnt, PARAMS, 10.0, tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_the_stage_reads_the_runs_of_the_evaluation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    row = {"pair_id": "a", "scene": "s", "estimator": "usac", "seed": 0, "status": "ok", "support": 9}
    row |= {"iterations": 1, "error_px": 2.0, "median_error_px": 1.0}
    for family in ("open", "rolled"):
        folder = tmp_path / "data" / "evaluation" / family
        folder.mkdir(parents=True)
        rows = pd.DataFrame([{"family": family, **row, "input": name} for name in ("standard", "default")])
        rows.to_csv(folder / "results.csv", index=False)
    params = SimpleNamespace(scenes=SimpleNamespace(families=("open", "rolled")))
    with pytest.raises(ReportError, match="'matches'"):
        stage.evaluated_runs(params)
    for path in tmp_path.glob("data/evaluation/*/results.csv"):
        pd.read_csv(path).assign(matches=12).to_csv(path, index=False)
    runs = stage.evaluated_runs(params)
    assert runs["family"].to_list() == ["open", "rolled"]
    assert runs["matches"].to_list() == [12, 12]


def test_rows_of_validation_pairs_are_those_of_the_evaluation(monkeypatch):
    class Pair:
        def __init__(self, name):
            self.pair_id, self.scene, self.files = name, f"scene of {name}", ()

    class Matches:
        def __init__(self):
            self.paths = {}

        def only(self, names):
            return tuple(names)

    asked = []

    def map_tasks(function, tasks, **options):
        assert function is cascade_rule.estimator_rows
        asked.extend(tasks)
        return [
            [{"estimator": t.payload["estimator"], "input": name, "seed": 4} for name in t.payload["hand_overs"]]
            for t in tasks
        ]

    monkeypatch.setattr(cascade_rule, "map_tasks", map_tasks)

    def store_matches(pairs, inputs, *_, **__):
        assert inputs == ("standard", "snn", "default")  # as another stage has them, though nothing runs on `snn` here
        return [Matches() for _ in pairs]

    monkeypatch.setattr(cascade_rule, "store_matches", store_matches)
    hand_overs = {name: {"standard": 1, "default": 2, "snn": 3} for name in ("usac", "prosac")}
    rows = cascade_rule.validation_rows(
        [Pair("a"), Pair("b")],
        inputs={"usac": ("standard", "default"), "prosac": ("default",)},
        matched=("standard", "snn", "default"),
        seeds=[4],
        hand_overs=hand_overs,
    )
    assert [t.name for t in asked] == ["a usac", "a prosac", "b usac", "b prosac"]
    assert asked[0].payload["hand_overs"] == {"standard": 1, "default": 2}
    assert rows[2] == {"pair_id": "a", "scene": "scene of a", "estimator": "prosac", "input": "default", "seed": 4}
    assert len(rows) == 6
