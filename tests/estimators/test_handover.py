"""Hand-over: the cuts, one-to-one, and the file that keeps the choices."""

import json
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import naive
from calls import refused
from epiprior.errors import FeatureError, SettingsError
from epiprior.estimators import handover, names
from epiprior.estimators.handover import HandOver, default_hand_over, hand_over, load_hand_overs, save_hand_overs
from epiprior.kernels.one_to_one import one_to_one_mask
from synthetic import make_matches


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2**40)), max_size=60))
@settings(deadline=None)
def test_one_to_one_is_its_naive_twin(pairs):
    first, second = (np.array([p[k] % (13 if k == 0 else 9) * 10**9 for p in pairs], np.int64) for k in (0, 1))
    assert np.array_equal(one_to_one_mask(first, second), naive.one_to_one(first, second))


def test_one_to_one_refuses_nonsense():
    refused(FeatureError, r"\(2,\) and \(3,\)", one_to_one_mask, np.arange(2), np.arange(3))
    refused(FeatureError, "-4", one_to_one_mask, np.array([1, -4]), np.array([0, 1]))


def test_cuts_come_before_one_to_one_and_top_k():
    """A dropped match must not use up the feature of one that stays."""
    x, ratio = np.arange(24.0).reshape(12, 2), np.where(np.arange(12) == 0, 0.99, 0.5)
    matches = make_matches(x, x, np.linspace(1, 0, 12), distance_ratio=ratio, feature1=np.array([0, 0, *range(1, 11)]))
    how = HandOver(max_distance_ratio=0.9, one_to_one=True, top_k=8)
    assert hand_over(matches, how).feature2.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [len(hand_over(matches.take(slice(n)), how)) for n in (0, 1, 2)] == [0, 0, 1]
    assert matches.one_to_one().feature2.tolist() == [0, *range(2, 12)]
    assert np.array_equal(hand_over(matches, HandOver()).x1, x)  # nothing asked for


def test_defaults_exist_for_everything_hold_without_a_file_and_are_overridden_by_what_one_names(tmp_path, monkeypatch):
    table = {name: {kind: default_hand_over(name, kind) for kind in handover.INPUTS} for name in names()}
    assert table["usac"]["standard"].max_distance_ratio == 0.85
    assert table["beem"]["default"].top_k > table["usac"]["default"].top_k > table["colmap"]["default"].top_k
    assert table["usac"]["default"].collect
    assert not table["usac"]["paper"].refine
    refused(SettingsError, "'lowe'", default_hand_over, "usac", "lowe")
    path = tmp_path / "hand_over.json"
    path.write_text('{"usac": {"default": {"top_k": 123, "refine": false}}}')
    table = load_hand_overs(path)
    assert set(table) == set(names())
    assert table["usac"]["default"] == replace(default_hand_over("usac", "default"), top_k=123, refine=False)
    assert table["usac"]["snn"] == default_hand_over("usac", "snn")
    assert set(load_hand_overs()) == set(names())
    monkeypatch.setattr(handover, "find_settings_file", lambda _: None)
    assert load_hand_overs()["magsac++"]["paper"] == default_hand_over("magsac++", "paper")


def test_file_round_trip_is_exact_byte_stable_and_holds_exceptions_only(tmp_path):
    table = {"prosac": {"snn": HandOver(threshold_px=0.75), "default": HandOver(top_k=200)}}
    save_hand_overs(tmp_path / "a.json", table)
    save_hand_overs(tmp_path / "b.json", {"prosac": dict(reversed(table["prosac"].items()))})
    assert load_hand_overs(tmp_path / "a.json")["prosac"].items() >= table["prosac"].items()
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    usual = {kind: default_hand_over("usac", kind) for kind in handover.INPUTS}
    save_hand_overs(tmp_path / "a.json", {"usac": usual | {"snn": HandOver(refine=True)}, "beem": {"snn": HandOver()}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"usac": {"snn": {"refine": True}}}


def test_bad_file_names_the_culprit(tmp_path):
    path = tmp_path / "hand_over.json"
    for content, culprit in (
        ('{"usak": {}}', "'usak'"),
        ('{"usac": {"lowe": {}}}', "'lowe'"),
        ('{"usac": {"snn": {"topk": 3, "top_k": 30}}}', "unknown topk;"),
        ('{"usac": {"snn": {"top_k": 3}}}', "usac, snn: top_k is 3"),
        ('{"usac": {"snn": []}}', "usac, snn: list"),
        ('{"usac": 7}', "usac is int"),
        ("[]", "the file is list"),
        ("{", "not JSON"),
        (None, "cannot be read"),
    ):
        path.unlink() if content is None else path.write_text(content)
        refused(SettingsError, rf"hand_over\.json: .*{culprit}", load_hand_overs, path)
