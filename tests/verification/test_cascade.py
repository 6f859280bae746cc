"""The rule of the cascade and its file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.estimators import run
from epiprior.types import Status
from epiprior.verification.cascade import CascadeRule, find_cascade_rule, load_cascade_rule, save_cascade_rule
from synthetic import HEIGHT, WIDTH, make_pair


@pytest.mark.parametrize(
    ("spread", "plausibility", "kept"),
    [(30, 0.9, True), (29, 0.99, False), (300, 0.89, False), (300, np.nan, False), (31, 1.0, True), (0, 1.0, False)],
)
def test_both_spread_and_plausibility_must_do(spread, plausibility, kept):
    rule = CascadeRule(min_spread=30, min_plausibility=0.9)
    assert rule.keeps_numbers("ok", spread, plausibility) is kept
    for status in set(Status) - {Status.OK}:
        assert not rule.keeps_numbers(status, spread, plausibility)


def test_an_unknown_plausibility_does_where_none_is_asked_for():
    assert CascadeRule(min_spread=30, min_plausibility=0.0).keeps_numbers("ok", 30, np.nan)


def test_an_estimate_is_judged_by_its_own_numbers():
    pair = make_pair(inliers=200, outliers=100)
    found = run("usac", replace(pair.matches, image_sizes=((WIDTH, HEIGHT), (WIDTH, HEIGHT))))
    spread, plausibility = found.spread, found.plausibility
    for rule, kept in (
        (CascadeRule(min_spread=spread, min_plausibility=plausibility), True),
        (CascadeRule(min_spread=spread + 1, min_plausibility=plausibility), False),
        (CascadeRule(min_spread=spread, min_plausibility=plausibility + 1e-6), False),
    ):
        assert rule.keeps(found) is kept
    assert not CascadeRule(min_spread=0, min_plausibility=0).keeps(replace(found, status=Status.DEGENERATE))


@pytest.mark.parametrize(
    "bad",
    [
        {"min_spread": -1},
        {"min_spread": 10.0},
        {"min_spread": True},
        {"min_plausibility": -0.1},
        {"min_plausibility": 1.1},
        {"min_plausibility": np.nan},
        {"min_plausibility": None},
        {"min_plausibility": True},
    ],
)
def test_values_out_of_range_are_named(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        CascadeRule(**bad)


def test_file_round_trip_is_exact_and_byte_stable(tmp_path):
    rule = CascadeRule(min_spread=41, min_plausibility=0.35)
    save_cascade_rule(tmp_path / "a.json", rule)
    save_cascade_rule(tmp_path / "b.json", replace(rule))
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert load_cascade_rule(tmp_path / "a.json") == rule


WHOLE = {"min_spread": 40, "min_plausibility": 0.5}


@pytest.mark.parametrize(
    ("content", "culprit"),
    [
        ({**WHOLE, "max_spread": 3}, "unknown max_spread; known: min_spread, min_plausibility"),
        ({"usac": WHOLE}, "unknown usac; known: min_spread"),
        ({"min_spread": 40}, "min_plausibility is missing"),
        ({**WHOLE, "min_spread": "40"}, "min_spread is '40'"),
        ([], "the file is list"),
    ],
)
def test_bad_file_names_the_culprit(tmp_path, content, culprit):
    path = tmp_path / "cascade.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SettingsError, match=rf"cascade\.json: .*{culprit}"):
        load_cascade_rule(path)


def test_unreadable_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"gone\.json: cannot be read"):
        load_cascade_rule(tmp_path / "gone.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(SettingsError, match=r"text\.json: not JSON"):
        load_cascade_rule(tmp_path / "text.json")


def test_without_a_file_the_defaults_hold(monkeypatch):
    monkeypatch.setattr("epiprior.verification.cascade.find_cascade_rule", lambda: None)
    assert load_cascade_rule() == CascadeRule()


def test_the_packaged_file_is_valid():
    assert find_cascade_rule().name == "cascade.json"
    assert load_cascade_rule() == load_cascade_rule(find_cascade_rule())
