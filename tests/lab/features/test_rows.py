"""Training rows: those of the library with their labels, and as they are stored."""

from dataclasses import fields, replace

import numpy as np
import pytest

import epiprior.matching.pair
from calls import note_calls
from epiprior.matching.pair import prepare_pair, roll_hypotheses
from epiprior.presets import find_preset
from epiprior.ranking import hypothesis
from epiprior_lab.features import detection, rows
from epiprior_lab.labels.ground_truth import label_matches

PRESETS = ("paper", "default")


@pytest.fixture(scope="module")
def pair(pairs, tmp_path_factory):
    """The relief with its true F: rows correspond."""
    path = tmp_path_factory.mktemp("relief") / "F.txt"
    np.savetxt(path, [[0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return replace(pairs[0], control_points_path=None, fundamental_path=path)


def unsure(rows):
    return np.full(len(rows), 0.5)


def equal(a, b):
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))


def test_features_are_found_once_and_stored_rows_are_read_as_they_were(pair, monkeypatch, tmp_path):
    detected = note_calls(monkeypatch, detection, "detect_features")
    monkeypatch.setattr(epiprior.matching.pair, "detect_features", None)
    found = {name: rows.extract_rows(pair, name) for name in PRESETS}
    assert len(detected) == 4
    assert [len(found[name]) for name in PRESETS] == [2, 1]  # `default` has one roll hypothesis where they agree
    (stored,) = found["default"]
    (tmp_path / "rows.npz").write_bytes(rows.rows_to_bytes(stored))
    read = rows.read_rows(tmp_path / "rows.npz")
    assert rows.rows_to_bytes(read) == rows.rows_to_bytes(stored)
    assert read.two_keypoints.columns == stored.two_keypoints.columns
    for classifiers in ((unsure,), (unsure, unsure)):
        for a, b in zip(rows.voted_rows(read, *classifiers), rows.voted_rows(stored, *classifiers), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", PRESETS)
def test_rows_are_those_of_the_library_with_their_labels(pair, name):
    settings = find_preset(name)
    prepared = prepare_pair(pair.image1, pair.image2, settings)
    found = rows.extract_rows(pair, name)
    assert tuple(each.roll_deg for each in found) == roll_hypotheses(prepared, settings)
    for each in found:
        candidates = hypothesis.find_candidates(prepared, each.roll_deg, settings)
        frames, found = candidates.united.frames, candidates.two_keypoints
        assert equal(each.united_frames, frames)
        wanted = label_matches(pair, frames.x1, frames.x2, frames.scale1, frames.scale2)
        np.testing.assert_array_equal(each.united_labels, wanted)
        assert 0 < wanted.sum() < len(wanted)
        frames = candidates.frames
        wanted = label_matches(pair, frames.x1, frames.x2, frames.scale1, frames.scale2)
        np.testing.assert_array_equal(each.two_keypoint_labels, wanted[found.main] & wanted[found.other])
