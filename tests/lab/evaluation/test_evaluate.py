"""Evaluation of pairs: runs of every estimator, input and seed, every measure that the truth allows, resuming."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from calls import note_calls
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.estimators.run import estimate_from_matches, solve
from epiprior.features.detect import FeatureSettings
from epiprior.geometry import sampson_distance
from epiprior.matching.baselines import snn_matches
from epiprior.types import FundamentalEstimate, Status
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.evaluation import inputs, runs
from epiprior_lab.evaluation.evaluate import evaluate
from epiprior_lab.evaluation.protocol import Protocol, make_protocol, pairs_of
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.evaluation.truth import Truth, pair_truth
from epiprior_lab.labels.ground_truth import TRUTH, error_px
from epiprior_lab.pairsets import fundamental_from_cameras
from epiprior_lab.params import MeasureParams, load_params
from synthetic import make_pair
from worlds import camera_pair, points_before, two_cameras

INPUTS = {"usac": ("standard", "snn", "default"), "magsac++": ("generalized", "default", "twin")}
SEEDS = (0, 1)


@pytest.fixture
def protocol(relief, tiny_model, monkeypatch):
    monkeypatch.setenv("EPIPRIOR_WORKERS", "1")
    chosen = load_hand_overs(None)
    hand_overs = {e: {n: chosen[e].get(n, HandOver()) for n in names} for e, names in INPUTS.items()}
    return Protocol(inputs=INPUTS, seeds=SEEDS, hand_overs=hand_overs, peers=relief.parent / "peers")


def test_runs_of_a_pair_of_which_only_what_changed_is_computed_again(pairs, protocol, tmp_path, monkeypatch):
    tables = evaluate(pairs, protocol, group="relief", store=tmp_path / "store")
    table = tables.runs
    number = sum(len(names) for names in INPUTS.values()) * len(SEEDS)
    assert (table["group"] == "relief").all()
    assert table.groupby("pair_id").size().to_dict() == {"relief-0": number, "blank-0": number}
    assert not table.duplicated(["pair_id", "estimator", "input", "seed"]).any()
    assert {e: tuple(dict.fromkeys(part["input"])) for e, part in table.groupby("estimator")} == INPUTS
    assert tables.pairs["pair_id"].tolist() == ["relief-0", "blank-0"]
    blank = table[(table["pair_id"] == "blank-0") & (table["input"] != "twin")]
    assert set(blank["status"]) == {"too_few_matches"}
    assert blank["error_px"].isna().all()
    assert (blank["support"] == 0).all()
    relief = table[table["pair_id"] == "relief-0"]
    assert set(relief["status"]) == {"ok"}
    assert (relief[["error_px", "distance"]] < [1, 0.02]).all(axis=None)
    assert relief["rotation_deg"].isna().all()  # no cameras
    row = relief[(relief["estimator"] == "usac") & (relief["input"] == "snn") & (relief["seed"] == 1)].iloc[0]
    pair, how = pairs[0], protocol.hand_overs["usac"]["snn"]
    with single_threaded():  # as tasks run: sums of several threads are taken in another order
        sets = (snn_matches(pair.image1, pair.image2),)
        estimate = estimate_from_matches(sets, estimator="usac", seed=child_seed(1, "relief-0"), hand_over=how)
    distances = sampson_distance(estimate.F, *pair.control_points())
    assert row["error_px"] == pytest.approx(distances.mean(), rel=1e-12)
    assert row["median_error_px"] == pytest.approx(np.median(distances), rel=1e-12)
    assert (row["support"], row["geometry"], row["matches"]) == (estimate.support, estimate.geometry, len(estimate.x1))
    assert row["confidence"] == estimate.confidence
    tables.write(tmp_path / "out")
    evaluate(pairs, protocol, group="relief", store=tmp_path / "store").write(tmp_path / "again")
    for name in Tables.kinds:
        assert (tmp_path / "again" / f"{name}.csv").read_bytes() == (tmp_path / "out" / f"{name}.csv").read_bytes()
    calls = note_calls(monkeypatch, runs, "estimate_from_matches")
    monkeypatch.setattr(inputs, "detect_pair", None)  # nothing is matched again
    hand_overs = {**protocol.hand_overs, "usac": {**protocol.hand_overs["usac"], "snn": HandOver(threshold_px=2.5)}}
    evaluate(pairs[:1], replace(protocol, hand_overs=hand_overs), group="relief", store=tmp_path / "store")
    assert ({how["estimator"] for _, how in calls}, len(calls)) == ({"usac"}, 3 * len(SEEDS))
    calls.clear()
    unused = {**hand_overs, "magsac++": {**hand_overs["magsac++"], "snn": HandOver(threshold_px=2.5)}}
    evaluate(pairs[:1], replace(protocol, hand_overs=unused), group="relief", store=tmp_path / "store")
    assert not calls


def test_a_deterministic_estimator_runs_once(monkeypatch):
    asked = []

    def run(sets, *, estimator, seed, **_):
        asked.append(seed)
        return len(asked)

    sets = (make_pair().matches,)
    matches = inputs.PairMatches(sets={"standard": sets, "snn": sets}, pixel_factors=(1.0, 1.0))
    how = {"estimator": "usac", "seeds": SEEDS, "hand_overs": dict.fromkeys(matches.sets, HandOver())}
    found = list(runs.each_run(run, matches, "p", **how))
    assert found == [("standard", 0, 1), ("standard", 1, 2), ("snn", 0, 3), ("snn", 1, 4)]
    assert asked == [child_seed(0, "p"), child_seed(1, "p")] * 2  # the same for every input
    asked.clear()
    monkeypatch.setattr(runs, "find_estimator", lambda name: SimpleNamespace(deterministic=True))
    assert [found for *_, found in runs.each_run(run, matches, "p", **how)] == [1, 1, 2, 2]
    assert len(asked) == 2


def test_f_without_its_verification_is_the_same(pairs, tiny_model):
    matches = inputs.match_pair(pairs[0], ("standard", "default"))
    for name, how in (("standard", HandOver(refine=True)), ("default", HandOver(collect=True, top_k=300))):
        for estimator in ("usac", "epiprior"):
            settings = {"estimator": estimator, "seed": 3, "hand_over": how, "pixel_factors": (2.0, 1.5)}
            found = solve(matches.sets[name], **settings).F
            np.testing.assert_array_equal(found, estimate_from_matches(matches.sets[name], **settings).F)


def test_an_estimate_is_measured_whatever_its_status(tmp_path):
    cameras = two_cameras()
    F, (x1, x2), pair = fundamental_from_cameras(*cameras), points_before(cameras), camera_pair(tmp_path, cameras)
    truth = Truth(labels="depth", points="cameras", x1=x1, x2=x2, F=F)
    known = {"F": F, "x1": x1, "x2": x2, "inliers": np.zeros(60, np.bool_), "support": 0}
    turned_down = FundamentalEstimate(status=Status.DEGENERATE, estimator="usac", **known)
    key = {"group": "g", "estimator": "usac", "input": "snn", "seed": 0, "threshold_px": 1.5}
    measures = MeasureParams(seed=1, distance_points=50)
    record = runs.run_record(turned_down, pair, truth, measures, **key)
    assert (record.status, record.input) == ("degenerate", "snn")
    assert max(record.error_px, record.distance) < 1e-6
    assert max(record.rotation_deg, record.translation_deg) < 1e-3
    none = runs.run_record(replace(turned_down, F=None), pair, truth, measures, **key)
    measured = (none.error_px, none.median_error_px, none.distance, none.rotation_deg, none.translation_deg)
    assert np.isnan(measured).all()
    assert np.isnan(error_px(None, x1, x2))
    no_f = runs.run_record(turned_down, replace(pair, camera2=None), replace(truth, F=None), measures, **key)
    assert no_f.error_px < 1e-6
    assert np.isnan((no_f.distance, no_f.rotation_deg)).all()


def test_thresholds_of_large_images_are_meant_at_working_size(pairs, tmp_path):
    """An image of 1230 pixels is worked on at 1024; its F and errors are in its own pixels."""
    paths = []
    for k, path in enumerate((pairs[0].image1, pairs[0].image2)):
        image = cv2.resize(cv2.imread(str(path)), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
        paths.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(paths[-1]), image)
    assert max(image.shape) > FeatureSettings().max_image_size
    matches = inputs.match_pair(replace(pairs[0], image1=paths[0], image2=paths[1]), ("snn",))
    factor = max(image.shape) / FeatureSettings().max_image_size
    assert matches.pixel_factors == pytest.approx((factor, factor))
    how = {"estimator": "usac", "seeds": (0,), "hand_overs": {"snn": HandOver(threshold_px=1.0)}}
    [(_, _, found)] = runs.estimates(matches, "p", **how)
    truth = pair_truth(pairs[0], TRUTH)
    assert error_px(found.F, 3 * truth.x1 + 1, 3 * truth.x2 + 1) < 2
    [(_, _, strict)] = runs.estimates(replace(matches, pixel_factors=(1.0, 1.0)), "p", **how)
    assert strict.support < found.support  # a pixel of the large image is less than a working pixel


def test_the_protocol_of_a_parameter_file(pairs, relief, monkeypatch):
    params = load_params("benchmarks/real/params.yaml")
    protocol = make_protocol(params)
    assert protocol.inputs["usac"] == ("standard", "snn", "default", "aliked", "xfeat")
    assert protocol.hand_overs["usac"]["snn"] == protocol.hand_overs["usac"]["aliked"] == HandOver()  # whole
    assert protocol.hand_overs["usac"]["default"] == load_hand_overs()["usac"]["default"] != HandOver()
    assert "aliked" not in protocol.inputs["beem"]
    assert protocol.all_inputs == (*protocol.inputs["usac"], "fast", "generalized")
    assert protocol.truth.one_plane == params.truth.one_plane
    assert protocol.measures.distance_points == params.measures.distance_points
    folders = {"pairs": f"{relief.parent}/{{group}}", "control_points": None}
    own = replace(params.evaluate, groups=("relief",), apart=None, **folders)
    assert [pair.pair_id for pair in pairs_of(own, "relief")] == [pair.pair_id for pair in pairs]
