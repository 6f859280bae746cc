"""The rule of the cascade and its file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from epiprior.cascade import CascadeRule, find_cascade_rules, load_cascade_rules, save_cascade_rules
from epiprior.errors import SettingsError
from epiprior.estimators import names, run
from epiprior.types import Status
from synthetic import make_pair


@pytest.mark.parametrize(
    ("support", "matches", "kept"),
    [(60, 120, True), (59, 100, False), (60, 121, False), (200, 400, True), (0, 0, False)],
)
def test_both_support_and_share_must_do(support, matches, kept):
    rule = CascadeRule(min_support=60, min_inlier_ratio=0.5)
    assert rule.keeps_support("ok", support, matches) is kept
    for status in set(Status) - {Status.OK}:
        assert not rule.keeps_support(status, support, matches)


def test_an_estimate_is_judged_by_its_own_numbers():
    pair = make_pair(inliers=200, outliers=100)
    found = run("usac", pair.matches)
    share = found.support / len(found.x1)
    for rule, kept in (
        (CascadeRule(min_support=found.support, min_inlier_ratio=share), True),
        (CascadeRule(min_support=found.support + 1, min_inlier_ratio=share), False),
        (CascadeRule(min_support=found.support, min_inlier_ratio=share + 0.01), False),
    ):
        assert rule.keeps(found) is kept
    assert not CascadeRule(min_support=0, min_inlier_ratio=0).keeps(replace(found, status=Status.DEGENERATE))


@pytest.mark.parametrize(
    "bad",
    [
        {"min_support": -1},
        {"min_support": 10.0},
        {"min_support": True},
        {"min_inlier_ratio": -0.1},
        {"min_inlier_ratio": 1.1},
        {"min_inlier_ratio": np.nan},
        {"min_inlier_ratio": None},
        {"min_inlier_ratio": True},
    ],
)
def test_values_out_of_range_are_named(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        CascadeRule(**bad)


def test_file_round_trip_is_exact_and_byte_stable(tmp_path):
    table = {"usac": CascadeRule(min_support=40, min_inlier_ratio=0.35), "prosac": CascadeRule()}
    save_cascade_rules(tmp_path / "a.json", table)
    save_cascade_rules(tmp_path / "b.json", dict(reversed(table.items())))
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    loaded = load_cascade_rules(tmp_path / "a.json")
    assert set(loaded) == set(names())
    assert loaded["usac"] == table["usac"]
    assert loaded["magsac++"] == CascadeRule()


WHOLE = {"min_support": 40, "min_inlier_ratio": 0.5}


@pytest.mark.parametrize(
    ("content", "culprit"),
    [
        ({"usak": WHOLE}, "unknown estimator 'usak'"),
        ({"usac": {**WHOLE, "max_support": 3}}, "usac: unknown max_support; known: min_support"),
        ({"usac": {"min_support": 40}}, "usac: min_inlier_ratio is missing"),
        ({"usac": {**WHOLE, "min_support": "40"}}, "usac: min_support is '40'"),
        ({"usac": []}, "usac: list, expected an object"),
        ([], "the file is list"),
    ],
)
def test_bad_file_names_the_culprit(tmp_path, content, culprit):
    path = tmp_path / "cascade.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SettingsError, match=rf"cascade\.json: .*{culprit}"):
        load_cascade_rules(path)


def test_unreadable_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"gone\.json: cannot be read"):
        load_cascade_rules(tmp_path / "gone.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(SettingsError, match=r"text\.json: not JSON"):
        load_cascade_rules(tmp_path / "text.json")


def test_without_a_file_the_defaults_hold(monkeypatch):
    monkeypatch.setattr("epiprior.cascade.find_cascade_rules", lambda: None)
    assert load_cascade_rules() == {name: CascadeRule() for name in names()}


def test_the_packaged_file_is_valid():
    assert find_cascade_rules() is None or find_cascade_rules().name == "cascade.json"
    assert set(load_cascade_rules()) == set(names())
