"""Rules of the cascade: what they keep and lose, how they are learnt, and what is reported."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.cascade_figure import cascade_figure
from epiprior_lab.report.cascade_tables import cascade_markdown, cascade_seconds, cascade_table
from epiprior_lab.report.study import ReportError
from epiprior_lab.selection import cascade_rule
from epiprior_lab.selection.cascade_rule import (
    ALL,
    NEVER,
    candidate_rules,
    cascade_errors,
    kept_runs,
    learn_rule,
    lost_runs,
    paired_runs,
    trade_off,
)
from epiprior_lab.stages import cascade as stage

PARAMS = CascadeParams(
    seeds=(0,),
    tolerance=0.01,
    strict_tolerance=0.01,
    min_plausibility=(0.0, 0.25, 0.5, 0.75),
)
AT = {"success_px": 10.0, "strict_px": 3.0}
INF = float("inf")


def runs_of(rows, estimator="usac"):
    """Rows are (scene, spread, plausibility, error without, error with)."""
    columns = ["scene", "spread", "plausibility", "without_px", "with_px"]
    table = pd.DataFrame(rows, columns=columns)
    table["status"] = np.where(np.isinf(table["without_px"]), "no_model", "ok")
    table["with_status"] = np.where(np.isinf(table["with_px"]), "no_model", "ok")
    table["pair_id"] = [f"pair-{i}" for i in range(len(table))]
    return table.assign(estimator=estimator, family="open", seed=0)


def test_runs_are_paired_and_other_inputs_left_out():
    def row(pair, name, seed, status, error):
        return {
            "family": "open", "pair_id": pair, "scene": "s", "estimator": "usac", "input": name, "seed": seed,
            "status": status, "spread": 40 if name == "standard" else 90, "plausibility": 0.8, "error_px": error,
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
    assert got["spread"].to_dict() == {("b", 1): 40, ("b", 0): 40, ("a", 0): 90}
    with pytest.raises(pd.errors.MergeError):
        paired_runs(pd.DataFrame([*rows, rows[0]]))


def test_a_cascade_takes_one_or_the_other_and_falls_back():
    runs = runs_of(
        [
            ("a", 120, 0.6, 1.0, 2.0),  # kept
            ("b", 120, 0.4, 50.0, 2.0),  # preprocessed
            ("c", 20, 0.9, 3.0, INF),  # preprocessed in vain: what was there is better than nothing
            ("d", 0, np.nan, INF, INF),
            ("e", 120, 0.6, 30.0, 1.0),  # kept, alas
        ]
    )
    rule = CascadeRule(min_spread=50, min_plausibility=0.5)
    kept = kept_runs(runs, [rule, NEVER])
    assert kept.tolist() == [[True, False, False, False, True], [False] * 5]
    assert cascade_errors(runs, kept[0]).tolist() == [1.0, 2.0, 3.0, INF, 30.0]
    assert lost_runs(runs, kept, 10.0).tolist() == [[False, False, False, False, True], [False] * 5]
    assert lost_runs(runs, kept, 1.5)[0].tolist() == [False, False, False, False, True]


def test_a_cascade_trusts_the_verdict_even_where_it_is_wrong():
    runs = runs_of([("a", 20, 0.6, 50.0, 2.0), ("b", 20, 0.6, 50.0, 2.0)])
    runs["with_status"] = "degenerate"
    runs.loc[1, "status"] = "degenerate"
    assert cascade_errors(runs, np.array([False, False])).tolist() == [50.0, 2.0]


def test_candidates_go_from_never_to_always():
    rules = candidate_rules(PARAMS)
    assert rules[0] == NEVER
    assert rules[1] == CascadeRule(min_spread=200, min_plausibility=0.75)
    assert rules[-1] == CascadeRule(min_spread=0, min_plausibility=0.0)
    assert len(set(rules)) == 17


def many_runs(n=60, bad_spread=80, seed=0):
    """Right answers have a spread of 150 to 400 and are plausible; wrong ones have less than `bad_spread`."""
    rng = np.random.default_rng(seed)
    right = rng.random(n) < 0.5
    spread = np.where(right, rng.integers(150, 400, n), rng.integers(8, bad_spread, n))
    plausibility = np.where(right, 0.8, 0.2)
    without = np.where(right, 0.5, 40.0)
    scenes = [f"s{i}" for i in range(n)]
    return runs_of(list(zip(scenes, spread, plausibility, without, np.full(n, 0.7), strict=True)))


def test_the_learnt_rule_tells_right_from_wrong_and_is_strict():
    runs = many_runs()
    found = learn_rule(runs, PARAMS, **AT)
    right = runs["without_px"] < 10
    outcome = found.outcomes.loc["usac"]
    assert outcome["preprocessed"] == pytest.approx(1 - right.mean())
    assert (outcome["lost"], outcome["held_out_lost"]) == (0.0, 0.0)
    # A spread of 50 and lower plausibilities would do as well on these runs.
    assert found.rule == CascadeRule(min_spread=100, min_plausibility=0.75)
    assert outcome["held_out_preprocessed"] == pytest.approx(outcome["preprocessed"], abs=0.1)


def test_each_tolerance_holds_at_its_own_threshold_and_wins_buy_nothing():
    rows = [("a", 300, 0.9, 1.0, 1.0)] * 97 + [("b", 250, 0.9, 5.0, 1.0)] * 3
    runs = runs_of([(f"{scene}{i}", *rest) for i, (scene, *rest) in enumerate(rows)])
    loose = replace(PARAMS, strict_tolerance=0.03)
    assert learn_rule(runs, PARAMS, **AT).rule == NEVER
    assert learn_rule(runs, loose, **AT).outcomes.loc[ALL, "preprocessed"] == 0.0
    wrong = runs.assign(without_px=runs["without_px"].replace(5.0, 50.0))
    assert learn_rule(wrong, loose, **AT).rule == NEVER
    assert learn_rule(wrong, replace(loose, tolerance=0.03), **AT).rule != NEVER
    wins = runs_of([(f"w{i}", 300, 0.9, 1.0, 50.0) for i in range(50)])
    won = pd.concat([runs, wins], ignore_index=True)
    assert learn_rule(won, PARAMS, **AT).rule == NEVER


def test_a_rule_has_a_margin_in_both_values():
    """A plausibility of 0.5 and a spread of 100 part right from wrong, but the wrong ones are just below."""
    right = [(f"r{i}", 250, 0.9, 1.0, 1.0) for i in range(10)] + [(f"q{i}", 110, 0.8, 1.0, 1.0) for i in range(10)]
    by_spread = runs_of([*right, ("w", 99, 0.9, 50.0, 1.0)])
    (kept,) = kept_runs(by_spread, [CascadeRule(min_spread=100, min_plausibility=0.75)])
    assert not lost_runs(by_spread, kept, 10.0).any()
    assert kept.sum() == 20
    found = learn_rule(by_spread, PARAMS, **AT)
    assert found.rule == CascadeRule(min_spread=200, min_plausibility=0.75)
    assert found.outcomes.loc[ALL, "preprocessed"] == pytest.approx(11 / 21)
    by_plausibility = runs_of([*right, ("w", 190, 0.49, 50.0, 1.0)])
    expected = CascadeRule(min_spread=100, min_plausibility=0.75)
    assert learn_rule(by_plausibility, PARAMS, **AT).rule == expected


def test_held_out_shares_show_a_rule_that_one_scene_decides():
    """The only wrong answer of much spread: without its scene, the rule would keep it."""
    runs = runs_of(
        [(f"s{i}", 250, 0.8, 1.0, 1.0) for i in range(30)]
        + [(f"t{i}", 120, 0.4, 1.0, 1.0) for i in range(30)]
        + [("bad", 120, 0.4, 90.0, 1.0)]
    )
    found = learn_rule(runs, PARAMS, **AT)
    assert found.outcomes.loc[ALL, "lost"] == 0.0
    assert found.outcomes.loc[ALL, "held_out_lost"] == pytest.approx(1 / 61)
    assert found.rule.min_spread == 200 or found.rule.min_plausibility > 0.4


def test_one_rule_serves_all_and_one_fooled_estimator_does_not_decide_alone():
    """`usac` takes one freak scene of 50 for a good one, which is 2 % of its own runs but not of all."""
    good = [(f"s{i}", 250, 0.9, 1.0, 1.0) for i in range(49)]
    freak, seen_through = ("freak", 250, 0.9, 50.0, 1.0), ("freak", 5, 0.3, 50.0, 1.0)
    others = [runs_of([*good, seen_through], estimator=name) for name in ("prosac", "beem")]
    usac = runs_of([*good, freak])
    assert learn_rule(usac, PARAMS, **AT).rule == NEVER
    found = learn_rule(pd.concat([usac, *others], ignore_index=True), PARAMS, **AT)
    assert found.rule.min_spread == 200
    assert list(found.outcomes.index) == ["usac", "prosac", "beem", ALL]
    assert found.outcomes["lost"].to_list() == pytest.approx([1 / 50, 0, 0, 1 / 150])
    assert found.outcomes["preprocessed"].to_list() == pytest.approx([0, 1 / 50, 1 / 50, 2 / 150])


def test_the_trade_off_falls_from_one_end_to_the_other():
    runs = many_runs(bad_spread=260, seed=2).assign(plausibility=0.8)
    front = trade_off(runs, PARAMS, 10.0)
    assert len(front) > 2
    assert (np.diff(front["preprocessed"]) < 0).all()
    assert (np.diff(front["lost"]) > 0).all()
    assert front["lost"].iloc[0] == 0
    kept = kept_runs(runs, candidate_rules(PARAMS))
    lost = lost_runs(runs, kept, 10.0).mean(axis=1)
    for share, loss in zip(1 - kept.mean(axis=1), lost, strict=True):
        assert ((front["preprocessed"] <= share + 1e-12) & (front["lost"] <= loss + 1e-12)).any()


@pytest.mark.parametrize(
    "bad",
    [
        {"tolerance": 1.5},
        {"strict_tolerance": -0.1},
        {"min_plausibility": (0.5, 0.5)},
        {"min_plausibility": (1.5,)},
        {"seeds": ()},
    ],
)
def test_bad_parameters_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        replace(PARAMS, **bad)


@pytest.fixture(scope="module")
def study():
    splits = {
        split: pd.concat(
            [
                many_runs(bad_spread=150, seed=seed).assign(estimator=name, family=family)
                for name in ("usac", "prosac")
                for family in ("open", "rolled")
            ],
            ignore_index=True,
        )
        for seed, split in enumerate(("validation", "test"))
    }
    splits["test"].loc[7, ["without_px", "with_px", "spread", "plausibility"]] = [60.0, 1.0, 399, 0.99]
    return splits, learn_rule(splits["validation"], PARAMS, **AT)


def test_the_table_counts_successes(study):
    splits, learnt = study
    table = cascade_table(splits, learnt.rule, thresholds_px=(10.0, 3.0), draws=200, seed=1)
    assert len(table) == 2 * 2 * 3 * 2
    by = table.set_index(["split", "estimator", "family", "threshold_px"])
    row = by.loc[("test", "usac", "open", 10.0)]
    part = splits["test"].query("estimator == 'usac' and family == 'open'")
    assert (row["pairs"], row["always"]) == (60, 60)
    assert row["without"] == (part["without_px"] < 10).sum()
    assert (row["lost"], row["won"], row["cascade"], row["change"]) == (1, 0, 59, -1)
    assert row["change_low"] < 0 <= row["change_high"]
    (kept,) = kept_runs(part, [learnt.rule])
    assert row["preprocessed"] == pytest.approx(1 - kept.mean())
    assert by.loc[("validation", "prosac", ALL, 3.0), "lost"] == 0
    again = cascade_table(splits, learnt.rule, thresholds_px=(10.0, 3.0), draws=200, seed=1)
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
    table = cascade_table(splits, learnt.rule, thresholds_px=(10.0,), draws=200, seed=1)
    text = cascade_markdown(table, learnt, replace(PARAMS, strict_tolerance=0.04), (10.0, 3.0))
    assert f"at least {learnt.rule.min_spread} cells of 48 x 48" in text
    assert f"at least {learnt.rule.min_plausibility:g}; otherwise" in text
    assert "1 % of the runs (pair, estimator and seed) below 10 px\nand 4 % below 3 px" in text
    for name in ("usac", "prosac", ALL):
        share = learnt.outcomes.loc[name, "preprocessed"]
        assert f"| {name} | {100 * share:.1f} % | 0.0 % |" in text
    never = cascade_markdown(table, replace(learnt, rule=NEVER), PARAMS, (10.0, 3.0))
    assert "every pair is preprocessed." in never
    assert "1000000" not in never
    assert "## Test pairs below 10 px: all families (120 pairs)" in text
    row = next(line for line in text.splitlines() if line.startswith("| usac") and "[" in line)
    assert " -1.0 [" in row
    for name in "ab":
        cascade_figure(splits, learnt.rule, PARAMS, 10.0, tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_the_stage_reads_the_runs_of_the_evaluation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    row = {"pair_id": "a", "scene": "s", "estimator": "usac", "seed": 0, "status": "ok", "support": 9, "spread": 7}
    row |= {"iterations": 1, "error_px": 2.0, "median_error_px": 1.0}
    for family in ("open", "rolled"):
        folder = tmp_path / "data" / "evaluation" / family
        folder.mkdir(parents=True)
        rows = pd.DataFrame([{"family": family, **row, "input": name} for name in ("standard", "default")])
        rows.to_csv(folder / "results.csv", index=False)
    params = SimpleNamespace(scenes=SimpleNamespace(families=("open", "rolled")))
    with pytest.raises(ReportError, match="'plausibility'"):
        stage.evaluated_runs(params)
    for path in tmp_path.glob("data/evaluation/*/results.csv"):
        pd.read_csv(path).assign(plausibility=0.5).to_csv(path, index=False)
    runs = stage.evaluated_runs(params)
    assert runs["family"].to_list() == ["open", "rolled"]
    assert runs["plausibility"].to_list() == [0.5, 0.5]
    assert runs["spread"].to_list() == [7, 7]


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
