"""Evaluation of photographs on one small pair: rows, measures, resuming, peers, times, the gallery's pictures."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import epiprior.rank
from epiprior.errors import SettingsError
from epiprior.estimators.handover import HandOver
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.ranking.models import load_model
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.compute.source_graph import source_files
from epiprior_lab.evaluation.photographs import (
    estimation,
    estimator_code,
    evaluation,
    facts,
    peer_matching,
    timing,
    truth,
)
from epiprior_lab.evaluation.photographs.params import load_real_params
from epiprior_lab.evaluation.photographs.peers import read_peer_matches
from epiprior_lab.evaluation.photographs.sets import link_sets
from epiprior_lab.pairsets import DatasetError, read_pair_set
from epiprior_lab.report.photographs.gallery import Case, draw_cases
from pictures import relief_pair, save
from tiny_model import make_model

ROOT = Path(__file__).parents[3]
INPUTS = {
    "usac": ("standard", "snn", "default", "twin"),
    "generalized-ransac": ("generalized", "default"),
    "epiprior": ("standard", "default"),
}
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def params():
    return load_real_params(ROOT / "benchmarks" / "real" / "params.yaml")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A set of one pair, and a peer whose matches are right."""
    root = tmp_path_factory.mktemp("photographs")
    folder = root / "relief"
    (folder / "images").mkdir(parents=True)
    (folder / "control_points").mkdir()
    for name, image in zip("ab", relief_pair(), strict=True):
        save(folder / "images" / f"{name}.png", image)
    (folder / "pairs.csv").write_text(
        "pair_id,image1,image2,gt,scene,difficulty\np,images/a.png,images/b.png,control_points,s,\n"
    )
    rng = np.random.default_rng(0)
    points = rng.uniform(20, 300, (60, 4))
    points[:, 3] = points[:, 1]  # rows correspond
    np.savetxt(folder / "control_points" / "p.csv", points[:30], delimiter=",", header="x1,y1,x2,y2", comments="")
    (root / "peers" / "twin").mkdir(parents=True)
    ones = dict.fromkeys(("scale1", "scale2", "orientation1_deg", "orientation2_deg"), np.ones(60))
    indices = dict.fromkeys(("feature1", "feature2"), np.arange(60))
    np.savez(root / "peers" / "twin" / "p.npz", x1=points[:, :2], x2=points[:, 2:], **ones, **indices)
    return root


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return load_model(make_model(tmp_path_factory.mktemp("models") / "default"))


@pytest.fixture
def ours(model, monkeypatch):
    monkeypatch.setattr(epiprior.rank, "load_model", lambda name: model)


def evaluate(root, params, **changes):
    settings = {
        "name": "relief",
        "inputs": INPUTS,
        "seeds": SEEDS,
        "hand_overs": {e: dict.fromkeys(names, HandOver(one_to_one=True)) for e, names in INPUTS.items()},
        "truth": params.truth,
        "measures": params.measures,
        "peers": root / "peers",
        "store": root / "store",
    }
    return evaluation.evaluate_set(read_pair_set(root / "relief").pairs, **(settings | changes))


@pytest.fixture
def found(root, params, ours):
    return evaluate(root, params)


def test_rows_of_every_estimator_input_and_seed(found):
    assert all(row["set"] == "relief" and row["pair_id"] == "p" and row["scene"] == "s" for row in found.results)
    asked = [(e, name, seed) for e, names in INPUTS.items() for name in names for seed in SEEDS]
    assert [(row["estimator"], row["input"], row["seed"]) for row in found.results] == asked
    table = pd.DataFrame(found.results)
    assert (table["status"] == "ok").all()
    assert (table["error_px"] < 3).all()
    assert (table["distance"] < 0.02).all()
    assert table["rotation_deg"].isna().all()  # no cameras
    once = table[table["estimator"] == "epiprior"].drop(columns="seed")
    assert once[::2].reset_index(drop=True).equals(once[1::2].reset_index(drop=True))


def test_rankings_and_split_follow_from_the_truth(found, params):
    (pair,) = found.pairs
    assert pair["labels"] == "epipolar"
    assert pair["points"] == "control_points"
    assert pair["split"] == "easy"
    assert pair["right_share"] > params.truth.easy_share
    rankings = pd.DataFrame(found.rankings).set_index("ranking")
    assert set(rankings.index) == {"standard", "snn", "default", "twin"}
    assert rankings["precision_100"].drop("twin").between(0.5, 1).all()
    assert rankings.loc["twin", "right"] == rankings.loc["twin", "matches"] == 60
    assert {row["preset"] for row in found.calibration} == {"default"}
    assert len(found.calibration) == 20


def test_what_is_stored_is_used_again(root, params, found, tmp_path, monkeypatch):
    def fail(**_):
        raise AssertionError("run again")

    fail.__module__, fail.__qualname__ = estimation.__name__, "photograph_rows"
    monkeypatch.setattr(evaluation, "photograph_rows", fail)
    again = evaluate(root, params)
    for out, rows in (("a", found), ("b", again)):
        rows.write(tmp_path / out)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == sorted(f"{name}.csv" for name in ("pairs", "results", "rankings", "ranking_curves", "calibration"))
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    with pytest.raises(Exception, match="run again"):
        evaluate(root, params, seeds=(0, 2))


def test_a_pair_on_a_plane_is_not_labelled(root, params, found, tmp_path):
    folder = tmp_path / "plane"
    (folder / "control_points").mkdir(parents=True)
    (folder / "images").symlink_to(root / "relief" / "images")
    (folder / "pairs.csv").write_bytes((root / "relief" / "pairs.csv").read_bytes())
    x = np.random.default_rng(1).uniform(20, 300, (30, 2))
    np.savetxt(folder / "control_points" / "p.csv", np.hstack([x, x + [20, 0]]), delimiter=",", header="x1,y1,x2,y2",
               comments="")  # fmt: skip
    (pair,) = read_pair_set(folder).pairs
    (twin,) = read_pair_set(root / "relief").pairs
    stored = evaluation.store_matches([twin], ("standard",), tmp_path / "matches")[0]
    found = facts.pair_facts(pair=pair, matches=stored, truth=params.truth)
    assert found.truth.F is None
    assert found.pair["labels"] == "none"
    assert found.pair["split"] == "unlabelled"
    assert found.rankings == found.calibration == []
    told = truth.pair_truth(twin, plane_px=3.0, one_plane=("p",))
    assert told.labels == "none"
    assert truth.pair_truth(twin, plane_px=3.0).labels == "epipolar"


def test_a_changed_estimator_makes_only_its_own_results_anew(root, params, found, monkeypatch):
    before = estimator_code.estimator_code
    changed = {"epiprior": "changed"}
    monkeypatch.setattr(evaluation, "estimator_code", lambda name: changed.get(name) or before(name))
    # Whatever is run anew finds out that it has other code; here that is the changed estimator alone.
    with pytest.raises(Exception, match=r"task 'p epiprior' failed.*estimator epiprior: this worker has other code"):
        evaluate(root, params)
    assert len(evaluate(root, params, inputs={name: INPUTS[name] for name in INPUTS if name != "epiprior"}).results) > 0


def test_code_of_an_estimator_is_no_other_ones():
    names = {name: {path.name for path in estimator_code.estimator_files(name)} for name in (*INPUTS, "beem")}
    assert {"opencv.py", "registry.py", "verdict.py", "estimate.py"} <= names["usac"]
    assert {"beem.py", "loop.py", "samplers.py"} <= names["beem"]
    assert not names["usac"] & {"beem.py", "loop.py", "epiprior.py", "poselib.py"}
    assert not names["beem"] & {"opencv.py", "blogs.py", "epiprior.py"}
    assert len({estimator_code.estimator_code(name) for name in names}) == len(names)
    with pytest.raises(SettingsError, match="'usak'"):
        estimator_code.estimator_files("usak")
    # What the tasks import by themselves holds no estimator; else every change would make everything anew.
    for module in (estimation, facts):
        assert not [path for path in source_files(Path(module.__file__)) if path.parent.name == "estimators"]


def test_damaged_matches_of_a_peer_are_named(root, tmp_path):
    good = dict(np.load(root / "peers" / "twin" / "p.npz"))
    for change, message in (
        ({"scale1": good["scale1"][:-1]}, "scale1 has shape"),
        ({"x1": good["x1"] * np.nan}, "not finite"),
        ({"x2": None}, "x2"),
    ):
        values = {name: value for name, value in (good | change).items() if value is not None}
        np.savez(tmp_path / "q.npz", **values)
        with pytest.raises(DatasetError, match=message):
            read_peer_matches(tmp_path / "q.npz")
    with pytest.raises(DatasetError, match="absent"):
        read_peer_matches(tmp_path / "absent.npz")


# Stands in for torch and another OpenCV: matches every feature of image 1 with the one of the same number.
SCRIPT = """
import json, sys
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
for pair_id, first, second, rankers in json.loads((folder / "pairs.json").read_text()):
    n = min(len(np.load(folder / f"{name}.npz")["xy"]) for name in (first, second))
    for k, ranker in enumerate(rankers):
        if ranker == "broken":
            sys.exit("it is broken")
        rows = np.column_stack([np.arange(n), np.arange(n)])[::-1][k:]
        np.savez(folder / f"{pair_id}.{ranker}.npz", rows=rows)
"""


def test_peers_run_in_an_environment_of_their_own(root, tmp_path):
    pairs = read_pair_set(root / "relief").pairs
    script, environment = tmp_path / "match.py", tmp_path / "peers"
    script.write_text(SCRIPT)
    settings = {"environment": environment, "script": script, "files": ()}
    peer_matching.write_peer_matches(pairs, (), tmp_path / "none", **settings)
    assert list((tmp_path / "none").iterdir()) == []
    with pytest.raises(SettingsError, match="make peers"):
        peer_matching.write_peer_matches(pairs, ("a",), tmp_path / "out", **settings)
    (environment / "bin").mkdir(parents=True)
    (environment / "bin" / "python").symlink_to(sys.executable)
    peer_matching.write_peer_matches(pairs, ("a", "b"), tmp_path / "out", **settings)
    photograph = load_photograph(pairs[0].image1)
    features = detect_features(photograph)
    for k, ranker in enumerate(("a", "b")):
        found = read_peer_matches(tmp_path / "out" / ranker / "p.npz")
        assert len(found) > 300
        np.testing.assert_array_equal(found.x1[::-1], features.xy[: len(found)])
        assert found.feature1.max() <= len(np.unique(features.xy, axis=0))
        assert np.isnan(found.probability).all()
        assert len(found) == len(read_peer_matches(tmp_path / "out" / "a" / "p.npz")) - k
    with pytest.raises(Exception, match="it is broken"):
        peer_matching.write_peer_matches(pairs, ("broken",), tmp_path / "out", **settings)


def test_times_of_a_cascade(root, ours, monkeypatch):
    clock = iter(np.arange(0.0, 1000.0))
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    (pair,) = read_pair_set(root / "relief").pairs
    inputs = {"usac": ("standard", "default"), "epiprior": ("standard", "default")}
    hows = {e: dict.fromkeys(names, HandOver(one_to_one=True)) for e, names in inputs.items()}
    always, never = (
        CascadeRule(min_spread=0, min_plausibility=0.0),
        CascadeRule(min_spread=10**6, min_plausibility=1.0),
    )
    for rule in (always, never):
        table = pd.DataFrame(timing.measure_pair(pair, inputs, hows, rule, (0,)))
        assert (table["preprocessed"] == (rule is never)).all()
        both = table["seconds_without"] + table["seconds_with"]
        if rule is always:
            assert (table["seconds_cascade"] == table["seconds_without"]).all()
        else:
            assert (table["seconds_cascade"] < both).all()  # features are found once


def test_pictures_of_the_gallery(root, ours, tmp_path):
    (pair,) = read_pair_set(root / "relief").pairs
    case = Case(kind="rescued", set_name="relief", pair_id="p", split="easy", right_share=0.7,
                estimator="usac", inputs=("standard", "default"), changed=1, of=1, succeeded=(0.0, 1.0), seeds=(0, 1),
                verdicts=("no_model", "ok"))  # fmt: skip
    hows = {"usac": dict.fromkeys(case.inputs, HandOver(one_to_one=True))}
    draw_cases(
        [case], {("relief", "p"): pair}, hand_overs=hows,
        photographs=tmp_path / "photographs", frames=tmp_path / "frames",
    )  # fmt: skip
    for name in case.inputs:
        real = cv2.imread(str(tmp_path / "photographs" / f"{case.name}-{name}.jpg"))
        blank = cv2.imread(str(tmp_path / "frames" / f"{case.name}-{name}.png"))
        assert real.shape == blank.shape
        # Nothing of the photograph is left: most of a frame is one and the same grey.
        _, counts = np.unique(blank.reshape(-1, 3), axis=0, return_counts=True)
        assert counts.max() > 0.4 * counts.sum()
        _, counts = np.unique(real.reshape(-1, 3), axis=0, return_counts=True)
        assert counts.max() < 0.4 * counts.sum()


def test_links_to_sets(root, tmp_path):
    folder = tmp_path / "data" / "real"
    with pytest.raises(SettingsError, match="make real DATA=FOLDER"):
        link_sets(("relief",), None, folder)
    assert link_sets(("relief",), root, folder) == [folder / "relief"]
    assert (folder / "relief").is_symlink()
    assert not (folder / "relief").readlink().is_absolute()
    assert link_sets(("relief",), root, folder) == link_sets(("relief",), None, folder)
    own = folder / "mine"
    own.mkdir()
    (own / "pairs.csv").touch()
    assert link_sets(("mine", "relief"), root, folder)[0] == own  # a set that lies there stays
    with pytest.raises(SettingsError, match="no pair set absent in"):
        link_sets(("relief", "absent"), root, folder)


def test_parameters_are_strict(params, tmp_path):
    with pytest.raises(SettingsError, match=r"apart: 'moon' is not among"):
        replace(params, apart=("moon",))
    with pytest.raises(SettingsError, match=r"whole: 'adalam'"):
        replace(params, whole=("adalam",))
    with pytest.raises(SettingsError, match="hard_share"):
        replace(params.truth, hard_share=0.9)
    text = (ROOT / "benchmarks" / "real" / "params.yaml").read_text()
    (tmp_path / "params.yaml").write_text(text.replace("plane_px:", "plain_px:"))
    with pytest.raises(SettingsError, match=r"unknown key truth\.plain_px"):
        load_real_params(tmp_path / "params.yaml")
    assert replace(params, peers=("gms",)).inputs["usac"] == ("standard", "snn", "default", "gms")
