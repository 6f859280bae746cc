"""Pairs that are relied on: by their confidence, what focal lengths contradict, and when they are not believed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from collections_fakes import in_this_process, small_images
from epiprior import match_collection
from epiprior.collection.database import write_database
from epiprior.collection.report import write_report
from epiprior.collection.store import MatchedPair
from epiprior.collection.verify import CONTRADICTS, CONTRADICTS_OTHERS, JudgedPairs, judge_pairs
from epiprior.presets import DEFAULT

pycolmap = pytest.importorskip("pycolmap")


def pair(confidence, count=100, geometry="UNCALIBRATED", **about):
    rows = np.column_stack([np.arange(count)] * 2)
    return MatchedPair(
        image1="a", image2="b", status="ok", confidence=confidence, geometry=geometry, matches=rows, **about
    )


def known(confidence, count=100, geometry="CALIBRATED", **about):
    return pair(confidence, count, geometry, E=np.eye(3), **about)


class Collection(list):
    """Pairs under cameras; `plain` are the same without."""

    def __init__(self, both):
        super().__init__(pair for _, pair in both)
        self.plain = self if all(one is two for one, two in both) else Collection((pair, pair) for pair, _ in both)
        self.pairs = [(2 * row, 2 * row + 1) for row in range(len(self))]
        self.how = SimpleNamespace(settings=DEFAULT)

    def read(self, pair):
        return self[self.pairs.index(pair)]


PLAIN = pair(0.9)
RIGHT = (PLAIN, known(0.95))
UNSURE = (PLAIN, known(0.1, 0, ""))
LOSES = (PLAIN, known(0.9, 120, guided=60))
UNKNOWN = (PLAIN, PLAIN)


def judged(*both):
    found = judge_pairs(Collection(both), 0.5)
    return [why for _, why in found], [pair.geometry for pair, _ in found], list(found.remarks)


def test_pairs_are_left_out_by_confidence_and_by_focal_lengths():
    low, nothing, saved = pair(0.4), pair(0.0, 0, ""), (pair(0.3), known(0.8))
    whys, kinds, told = judged(RIGHT, UNSURE, UNKNOWN, RIGHT, (low, low), (nothing, nothing), saved)
    assert whys == ["", CONTRADICTS, "", "", "low confidence", "ok", ""]
    assert kinds == ["CALIBRATED", "", "UNCALIBRATED", "CALIBRATED", "UNCALIBRATED", "", "CALIBRATED"]
    assert told == ["1 of 3 pairs contradict the focal lengths of their cameras: left out"]
    assert judged(RIGHT, UNKNOWN) == (["", ""], ["CALIBRATED", "UNCALIBRATED"], [])


def test_a_pair_that_loses_matches_is_right_unless_most_do():
    assert judged(RIGHT, LOSES) == (["", ""], ["CALIBRATED", "CALIBRATED"], [])
    whys, kinds, told = judged(LOSES, RIGHT, UNSURE)
    assert (whys, kinds) == (["", "", ""], ["UNCALIBRATED"] * 3)
    assert told == ["2 of 3 pairs contradict the focal lengths of their cameras: these are wrong, and not used"]


def test_the_report_says_which_images_have_pairs_that_contradict(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set", ("a.png", "b.png"))
    found = match_collection(tmp_path / "set")

    for why in (CONTRADICTS, CONTRADICTS_OTHERS):
        judged = JudgedPairs(matched=found, trusted=True, why_not=(why,), remarks=("1 of 1 pairs contradict",))
        write_report(tmp_path / "report.html", judged, [])
        page = (tmp_path / "report.html").read_text()
        assert page.count(f"no pair has a geometry, 1 {why.replace('contradicts', 'contradict')}<") == 2
        assert "0 of 1 pairs have a geometry. 1 of 1 pairs contradict" in page
        assert f"not written: {why}" in page


def test_focal_lengths_that_are_not_believed_are_no_prior_ones_but_pairs_keep_them(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set", ("a.png", "b.png"))
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 300, 200, 150)
    camera.has_prior_focal_length = True
    cameras = {"a.png": camera, "b.png": camera}
    found = match_collection(tmp_path / "set", cameras=cameras)
    for trusted in (False, True):
        write_database(
            tmp_path / f"{trusted}.db", replace(judge_pairs(found, 0.5), trusted=trusted), list(cameras.items())
        )
        with pycolmap.Database.open(tmp_path / f"{trusted}.db") as opened:
            assert {one.has_prior_focal_length for one in opened.read_all_cameras()} == {trusted}
        assert found.cameras_of((0, 1)) is not None


def test_of_three_pairs_that_contradict_the_least_sure_is_left_out(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set", ("a.png", "b.png", "c.png"))
    found = match_collection(tmp_path / "set")
    sure = {(0, 1): 0.9, (0, 2): 0.6, (1, 2): 0.8}
    matches = {pair: np.column_stack([np.arange(20)] * 2) for pair in sure}
    about = {}

    def changed(self, pair):
        own = about if pair == (0, 2) else {}
        return replace(self.store.read(self.key(pair)), confidence=sure[pair], matches=matches[pair], **own)

    monkeypatch.setattr(type(found), "read", changed)
    assert [why for _, why in judge_pairs(found, 0.5)] == ["", "", ""]
    matches[0, 2] = np.column_stack([np.arange(20), np.arange(20)[::-1]])
    judged = judge_pairs(found, 0.5)
    assert [why for _, why in judged] == ["", CONTRADICTS_OTHERS, ""]
    assert judged.remarks == ("1 of 3 pairs contradict others: left out",)
    assert [why for _, why in judge_pairs(found, 0.7)] == ["", "low confidence", ""]
    for other in ({"guided": 20}, {"geometry": "WATERMARK"}):  # neither is evidence
        about = other
        assert [why for _, why in judge_pairs(found, 0.5)] == ["", "", ""]
    about, sure[0, 2] = {"geometry": "PLANAR"}, 1.0  # which is no probability
    assert [why for _, why in judge_pairs(found, 0.5)] == ["", CONTRADICTS_OTHERS, ""]
