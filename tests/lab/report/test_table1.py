"""The paper's Table 1, and how the cascade's rule is told."""

import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.cascade import learnt_page, rule_in_words
from epiprior_lab.report.page import render_markdown
from epiprior_lab.report.table1 import named_pairs, table1_page
from epiprior_lab.selection.cascade_rule import NEVER, LearntRule


def test_named_pairs_are_at_quantiles_of_right_matches_in_x_l():
    shares = {"a": 0.5, "b": 0.1, "c": 0.3, "d": float("nan"), "e": 0.3}
    pairs = pd.DataFrame({"pair_id": list(shares), "right_share": list(shares.values())})
    assert named_pairs(pairs, (0.0, 0.5, 1.0)) == ["b", "e", "a"]
    assert named_pairs(pairs, (0.0, 0.1)) == ["b"]


def test_table_1(study):
    tables = study.results.tables
    text = render_markdown(table1_page(tables, (0.0, 1.0), 10.0, picture="table1.jpg"))
    assert text.count("| matches |") == 4
    pair_id = named_pairs(tables.pairs[tables.pairs["group"] == "open"], (0.0,))[0]
    block = text[text.index(f"| `{pair_id}` |") :].splitlines()
    ranked = tables.rankings[tables.rankings["pair_id"] == pair_id].set_index(["input", "ranking"])
    assert block[5].split(" | ")[1:] == [
        str(ranked.loc[place, "right_100"]) + (" |" if k == 3 else "")
        for k, place in enumerate([("paper", "lowe"), ("paper", "blogs"), ("paper", "final"), ("default", "final")])
    ]
    runs = tables.runs[(tables.runs["pair_id"] == pair_id) & (tables.runs["input"] == "default")]
    won = (runs["error_px"] < 10).groupby(runs["estimator"], sort=False).mean() > 0.5
    told = block[6].split(" | ")[-1]
    assert told.startswith(f"{won.sum()} of {len(won)}")
    assert "–" in block[6]


def test_the_rule_in_words():
    columns = ("preprocessed", "lost", "held_out_preprocessed", "held_out_lost")
    outcomes = pd.DataFrame([[0.5, 0.01, 0.6, 0.02]] * 2, index=["usac", "all"], columns=columns)
    params = CascadeParams(seeds=(0,), tolerance=0.01, strict_tolerance=0.04, min_plausibility=(0.5, 0.9))
    learnt = LearntRule(rule=CascadeRule(min_plausibility=0.9), outcomes=outcomes)
    text = render_markdown(learnt_page(learnt, params, 10.0, 3.0, "cascade.png"))
    assert "| usac | 50.0 % | 1.0 % | 60.0 % | 2.0 % |" in text
    assert "least 0.9; otherwise the pair is preprocessed" in " ".join(text.split())
    assert "1.0%" in text
    assert "every pair is preprocessed" in rule_in_words(NEVER)
