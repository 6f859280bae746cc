from dataclasses import fields
from pathlib import Path

import numpy as np

import epiprior.matching.pair
from calls import note_calls, refused
from epiprior.errors import SettingsError
from epiprior.presets import find_preset
from epiprior.rank import rank_matches
from epiprior_lab.compute.source_graph import source_files
from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.evaluation import inputs
from epiprior_lab.features import detection
from epiprior_lab.pairsets import DatasetError


def test_shared_features_and_files_change_nothing(pairs, tiny_model, tmp_path):
    [files] = inputs.store_matches(pairs[:1], ("standard", "default"), tmp_path / "matches")
    got = inputs.read_matches({"default": files["default"]})
    with single_threaded():  # as tasks run: sums of several threads are taken in another order
        wanted = rank_matches(pairs[0].image1, pairs[0].image2).sets
    assert (list(got.sets), len(got.sets["default"])) == (["default"], len(wanted))
    for a, b in zip(got.sets["default"], wanted, strict=True):
        np.testing.assert_array_equal(a.probability, b.probability)
        np.testing.assert_array_equal(a.x2, b.x2)
        np.testing.assert_array_equal(a.rough_matrices, b.rough_matrices)
    assert got.pixel_factors == (1.0, 1.0)
    assert min(got.features["default"]) > 300


def test_matches_do_not_depend_on_estimators_and_an_unknown_input_is_named(pairs):
    """So that a changed estimator leaves stored matches as they are."""
    assert not [file for file in source_files(Path(inputs.__file__)) if file.parent.name == "estimators"]
    refused(SettingsError, "'lowe'", inputs.match_pair, pairs[0], ("lowe",))


def test_the_printed_method_has_features_of_its_own_and_others_are_detected_once(pairs, tiny_model, monkeypatch):
    found = inputs.match_pair(pairs[0], ("standard", "paper-standard", "fast", "default"))
    least = find_preset("paper").features.min_scale
    assert found.sets["paper-standard"][0].scale1.min() >= least > found.sets["standard"][0].scale1.min()
    alone = rank_matches(pairs[0].image1, pairs[0].image2, preset="fast").sets
    assert [len(each) for each in found.sets["fast"]] == [len(each) for each in alone]
    assert found.features["standard"] == found.features["default"] != found.features["paper-standard"]
    wanted = {name: inputs.match_pair(pairs[0], (name,)).sets[name] for name in ("snn", "generalized", "default")}
    detected = note_calls(monkeypatch, detection, "detect_features")
    monkeypatch.setattr(epiprior.matching.pair, "detect_features", None)
    got = inputs.match_pair(pairs[0], tuple(wanted)).sets
    assert len(detected) == 2
    for name, sets in wanted.items():
        for a, b in zip(got[name], sets, strict=True):
            for column in fields(a):
                np.testing.assert_array_equal(getattr(a, column.name), getattr(b, column.name))


def test_matches_of_a_peer_are_kept_beside_our_own_with_their_features_or_named_if_damaged(pairs, relief, tmp_path):
    files = inputs.store_matches(pairs[:1], ("standard", "twin"), tmp_path, peers=relief.parent / "peers" / "relief")[0]
    read = inputs.read_matches(files)
    (found,), own = read.sets["twin"], read.features["standard"]
    assert read.features["twin"] == own
    assert min(own) > 300
    np.testing.assert_allclose(found.x1, pairs[0].control_points()[0])
    assert np.isnan(found.probability).all()
    assert found.image_sizes == read.sets["standard"][0].image_sizes
    refused(DatasetError, "matches of twin", inputs.store_matches, pairs[:1], ("standard", "twin"), tmp_path)
    good = dict(np.load(relief.parent / "peers" / "relief" / "twin" / "relief-0.npz"))
    for change, message in (
        ({"scale1": good["scale1"][:-1]}, "scale1 has shape"),
        ({"x1": good["x1"] * np.nan}, "not finite"),
        ({"x2": None}, "x2"),
        ({"orientation1_deg": None}, "orientation1_deg"),
        ({"features": np.array([3])}, "out of bounds"),
    ):
        values = {name: value for name, value in (good | change).items() if value is not None}
        np.savez(tmp_path / "q.npz", **values)
        refused(DatasetError, message, inputs.read_peer_matches, tmp_path / "q.npz")
    refused(DatasetError, "absent", inputs.read_peer_matches, tmp_path / "absent.npz")
    values = {name: good[name] for name in ("x1", "x2", "feature1", "feature2")}
    np.savez(tmp_path / "q.npz", **values, features=np.array([2048, 1500]))
    found, counts = inputs.read_peer_matches(tmp_path / "q.npz")
    assert counts == (2048, 1500)
    np.testing.assert_array_equal(found.x2, values["x2"])
    assert np.isnan([found.scale1, found.scale2, found.orientation1_deg, found.orientation2_deg]).all()
    assert (np.diff(found.distance_ratio) > 0).all()
