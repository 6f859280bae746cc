import json
from dataclasses import replace

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.settings_file import find_settings_file
from epiprior.types import Geometry, Status
from epiprior.verification.cascade import FLAT, CascadeRule, load_cascade_rule, save_cascade_rule
from synthetic import make_pair, run


@pytest.mark.parametrize(("confidence", "kept"), [(0.9, True), (0.89, False), (np.nan, False), (1.0, True)])
def test_confidence_decides_where_there_is_an_F(confidence, kept):
    rule = CascadeRule(min_confidence=0.9)
    assert rule.keeps_numbers("ok", "general", confidence) is kept
    for status in set(Status) - {Status.OK}:
        assert not rule.keeps_numbers(status, "none", confidence)
    for geometry in FLAT:  # sure as well, of a homography
        assert rule.keeps_numbers("degenerate", str(geometry), 1 - confidence) is kept


def test_what_a_cascade_answers():
    good = run("usac", make_pair(inliers=200, outliers=100).matches)
    flat = replace(good, status=Status.DEGENERATE, geometry=Geometry.PLANAR, confidence=0.05)
    nothing = replace(good, status=Status.NO_MODEL, geometry=Geometry.NONE, confidence=0.05)
    rule, unsure = CascadeRule(min_confidence=0.99), replace(good, confidence=0.7)
    for first, second, answer in (
        (unsure, flat, 0), (unsure, good, 1), (flat, unsure, 1), (flat, nothing, 0), (nothing, flat, 1),
        (flat, flat, 1), (replace(flat, confidence=0.005), good, 0), (replace(good, confidence=0.995), good, 0),
    ):  # fmt: skip
        assert rule.choose(first, second) is (first, second)[answer]


def test_a_file_is_read_or_its_culprit_named_the_packaged_one_valid_and_none_the_defaults(tmp_path, monkeypatch):
    rule = CascadeRule(min_confidence=0.35)
    save_cascade_rule(tmp_path / "a.json", rule)
    assert load_cascade_rule(tmp_path / "a.json") == rule
    for content, culprit in (
        ({"min_confidence": 0.5, "min_spread": 3}, "unknown min_spread; known: min_confidence"),
        ({"min_confidence": "0.5"}, "min_confidence is '0.5'"),
        ([], "the file is list"),
    ):
        (tmp_path / "a.json").write_text(json.dumps(content))
        with pytest.raises(SettingsError, match=rf"a\.json: .*{culprit}"):
            load_cascade_rule(tmp_path / "a.json")
    assert load_cascade_rule() == load_cascade_rule(find_settings_file("cascade.json"))
    monkeypatch.setattr("epiprior.verification.cascade.find_settings_file", lambda _: None)
    assert load_cascade_rule() == CascadeRule()
