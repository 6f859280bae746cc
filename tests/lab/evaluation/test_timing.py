import numpy as np
import pytest

from epiprior.estimators.handover import HandOver
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation import timing
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.records import CASCADE, TimingRecord, to_frame

INPUTS = {"usac": ("standard", "snn", "default", "twin"), "magsac++": ("snn", "default")}


@pytest.mark.parametrize("kept", [True, False])
def test_times_of_every_input_and_of_the_cascade(pairs, tiny_model, monkeypatch, kept):
    clock = iter(np.arange(0.0, 1000.0))
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(CascadeRule, "keeps", lambda self, estimate: kept)
    hand_overs = {e: dict.fromkeys(names, HandOver()) for e, names in INPUTS.items()}  # of magsac++ not the library's
    protocol = Protocol(inputs=INPUTS, seeds=(0, 1, 2), hand_overs=hand_overs)
    records = timing.time_pair(pairs[0], protocol, CascadeRule(), group="g", seeds=(0, 1))
    table = to_frame(TimingRecord, records).set_index(["estimator", "input", "seed"])
    timed = [(e, name) for e, names in INPUTS.items() for name in names if name != "twin"] + [("usac", CASCADE)]
    assert set(table.index) == {(*each, seed) for each in timed for seed in (0, 1)}
    parts = table[["seconds_features", "seconds_matching", "seconds_estimator"]]
    np.testing.assert_allclose(parts.sum(axis=1), table["seconds_total"])
    assert (parts > 0).all(axis=None)
    assert (table["error_px"] < 3).all()
    first, second, both = (table.loc[("usac", name, 0)] for name in ("snn", "default", CASCADE))
    assert (first["preprocessed"], second["preprocessed"], both["preprocessed"]) == (False, True, not kept)
    if kept:
        assert (both["seconds_total"], both["error_px"]) == (first["seconds_total"], first["error_px"])
    else:  # features are found once
        whole = first["seconds_total"] + second["seconds_total"]
        assert both["seconds_total"] == pytest.approx(whole - second["seconds_features"])
        assert both["error_px"] == second["error_px"]


def test_times_of_a_learned_matcher_and_of_pairs_taken_evenly(pairs, tmp_path, monkeypatch):
    points = pairs[0].control_points()
    index = np.arange(len(points[0]))
    columns = {"x1": points[0], "x2": points[1], "feature1": index, "feature2": index, "features": np.array([90, 80])}
    asked = []

    def match(*, images, peer, python, script, threads):
        asked.append((images, peer, python, threads))
        return [columns] * len(images), [(3.0, 1.0)] * len(images)

    monkeypatch.setattr(timing, "time_learned", match)
    inputs = {"usac": ("standard", "xfeat"), "epiprior": ("standard",)}
    hand_overs = {e: dict.fromkeys(names, HandOver()) for e, names in inputs.items()}
    protocol = Protocol(inputs=inputs, seeds=(0,), hand_overs=hand_overs)
    chosen = [("g", pairs[0]), ("g", pairs[0])]
    records = timing.time_learned_pairs(chosen, "xfeat", protocol, seeds=(0, 1), python=tmp_path, threads=3)
    assert asked == [([(pairs[0].image1, pairs[0].image2)] * 2, "xfeat", tmp_path, 3)]
    table = to_frame(TimingRecord, records)
    assert table["seed"].tolist() == [0, 1, 0, 1]
    assert set(table["estimator"]) == {"usac"}
    assert (table["seconds_features"] == 3.0).all()
    np.testing.assert_allclose(table["seconds_total"] - table["seconds_estimator"], 4.0)
    assert (table["error_px"] < 1).all()
    assert not table["preprocessed"].any()
    assert (timing.spread_pairs(list(range(10)), 3), timing.spread_pairs([1, 2], 3)) == ([0, 3, 6], [1, 2])
