"""Pairs that are relied on: what known focal lengths confirm, what they contradict, and when they are not believed."""

from dataclasses import replace

import numpy as np
import pytest

from collections_fakes import in_this_process, small_images
from epiprior import match_collection
from epiprior.collection.report import write_report
from epiprior.collection.store import MatchedPair
from epiprior.collection.verify import CONTRADICTS, MIN_CALIBRATED, judge_pairs, under_cameras
from synthetic import FOCAL, HEIGHT, WIDTH, K, make_pair

pycolmap = pytest.importorskip("pycolmap")

PAIR = make_pair(inliers=150, outliers=0, noise_px=0.3)
XY = PAIR.matches.x1, PAIR.matches.x2


def camera(focal, scale=1):
    made = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", scale * focal, scale * WIDTH, scale * HEIGHT)
    made.params = [scale * focal, scale * WIDTH / 2 + 0.5, scale * HEIGHT / 2 + 0.5]
    return made


class Collection(list):
    """Pairs under cameras; without, `calibrated` is not known."""

    @property
    def plain(self):
        return Collection(replace(pair, calibrated=None, geometry=pair.geometry and "UNCALIBRATED") for pair in self)


def judged(pairs, told):
    return [why for _, why in judge_pairs(Collection(pairs), 0.5, told.append)]


def under(pair, *focal_lengths, scale=1, keypoints=XY):
    cameras = tuple(camera(focal, scale) for focal in focal_lengths)
    return under_cameras(pair, cameras, tuple(scale * xy for xy in keypoints), max_image_size=WIDTH)


def matched(**changes):
    rows = np.arange(150)
    about = {"image1": "a", "image2": "b", "status": "ok", "geometry": "UNCALIBRATED", "confidence": 0.9, "F": PAIR.F}
    return MatchedPair(**(about | {"matches": np.column_stack([rows, rows])} | changes))


def test_known_focal_lengths_confirm_a_right_pair_and_sort_out_what_was_gathered():
    wrong = np.column_stack([np.arange(150), np.roll(np.arange(150), 40)])[:30]
    pair = matched(matches=np.vstack([matched().matches, wrong]), guided=30)
    found = under(pair, FOCAL, FOCAL)
    assert found.geometry == "CALIBRATED"
    assert found.calibrated > 0.95
    assert found.guided < 15
    assert len(found.matches) == len(np.unique(found.matches[:, 0])) + found.guided
    x1, x2 = (np.column_stack([xy[:150], np.ones(150)]) @ np.linalg.inv(K).T for xy in XY)
    assert np.median(np.abs(np.einsum("ni,ij,nj->n", x2, found.E / np.linalg.norm(found.E), x1))) < 1e-3


def test_a_pair_that_contradicts_the_focal_lengths_stays_as_it_is_and_is_told():
    found = under(matched(), 4 * FOCAL, FOCAL / 4)
    assert found.geometry == "UNCALIBRATED"
    assert found.calibrated < MIN_CALIBRATED
    assert found.E is None
    np.testing.assert_array_equal(found.matches, matched().matches)
    flat = matched(geometry="PLANAR", F=None)
    assert under(flat, FOCAL, FOCAL) is flat


def test_thresholds_are_of_working_pixels():
    noisy = make_pair(inliers=150, outliers=0, noise_px=0.9)
    xy = noisy.matches.x1, noisy.matches.x2
    small, large = (under(matched(F=None), FOCAL, FOCAL, scale=scale, keypoints=xy) for scale in (1, 6))
    assert small.calibrated == pytest.approx(large.calibrated, abs=0.01)
    assert small.calibrated > 0.95


def test_pairs_are_left_out_by_confidence_and_focal_lengths_unless_most_contradict_these():
    right, against, unknown = matched(calibrated=0.99), matched(calibrated=0.5), matched()
    others = [
        matched(confidence=0.4, calibrated=0.1),
        matched(status="no_model", geometry="", matches=np.empty((0, 2))),
    ]
    told = []
    whys = judged([right, against, unknown, right, *others], told)
    assert whys == ["", CONTRADICTS, "", "", "low confidence", "no_model"]
    assert told == ["1 of 3 pairs contradict the focal lengths of their cameras: left out"]
    assert judged([right, against, against], told) == ["", "", ""]
    assert "2 of 3" in told[1]
    assert "not used" in told[1]
    calibrated = replace(right, geometry="CALIBRATED")
    found = judge_pairs(Collection([calibrated, against, against]), 0.5)
    assert [pair.geometry for pair, _ in found] == ["UNCALIBRATED"] * 3
    assert judged([right, unknown], told) == ["", ""]
    assert len(told) == 2


def test_the_report_says_which_images_have_pairs_that_contradict(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set", ("a.png", "b.png"))
    found = match_collection(tmp_path / "set")

    def one_against(matched, least, tell):
        tell("1 of 1 pairs contradict")
        return [(pair, CONTRADICTS) for pair in matched]

    monkeypatch.setattr("epiprior.collection.report.judge_pairs", one_against)
    write_report(tmp_path / "report.html", found, [], 0.5)
    page = (tmp_path / "report.html").read_text()
    assert page.count("no pair has a geometry, 1 contradict the focal lengths") == 2
    assert "0 of 1 pairs have a geometry. 1 of 1 pairs contradict" in page
    assert f"not written: {CONTRADICTS}" in page
