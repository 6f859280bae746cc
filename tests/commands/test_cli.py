"""The command line: what it prints, writes and returns."""

import errno
import json
import logging
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import epiprior
from epiprior import FundamentalEstimate, ImageError, ModelError, RankedMatches, Status
from epiprior.cli import app
from epiprior.io import read_matches
from epiprior.presets import find_preset
from pictures import relief_pair, save, texture
from synthetic import make_matches, make_pair
from tiny_model import make_model

KEYS = [
    "status",
    "F",
    "support",
    "matches",
    "spread",
    "plausibility",
    "iterations",
    "estimator",
    "version",
    "input",
    "preset",
    "roll_deg",
    "seed",
    "seconds",
    "message",
]
PAIR = make_pair(seed=1)


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def one_line(result):
    """The only line on stderr."""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    return lines[0]


def estimate_of(status=Status.OK, message="", **changes):
    ok = status is Status.OK
    inliers = PAIR.right if ok else np.zeros(len(PAIR.right), bool)
    found = FundamentalEstimate(
        status=status,
        F=PAIR.F if ok else None,
        x1=PAIR.matches.x1,
        x2=PAIR.matches.x2,
        inliers=inliers,
        support=int(inliers.sum()),
        iterations=17,
        estimator="usac",
        version="opencv 5",
        input="default",
        message=message,
        seconds={"estimator": 0.25},
        spread=41 if ok else 0,
        plausibility=0.875,
    )
    return replace(found, **changes)


@pytest.fixture
def library(monkeypatch):
    """Stands in for the library: notes how it is called, returns or raises what the test puts in."""
    calls = {}
    state = {"estimate": estimate_of(), "sets": (PAIR.matches, replace(PAIR.matches, roll_deg=90.0))}

    def estimate_fundamental(image1, image2, **options):
        calls["estimate"] = options | {"images": (image1, image2)}
        if isinstance(state["estimate"], Exception):
            raise state["estimate"]
        return state["estimate"]

    def rank_matches(image1, image2, **options):
        calls["rank"] = options | {"images": (image1, image2)}
        return RankedMatches(sets=state["sets"], standard=PAIR.matches, seconds={}, preset="default")

    def standard_matches(image1, image2, **options):
        calls["standard"] = True
        return PAIR.matches

    monkeypatch.setattr(epiprior, "estimate_fundamental", estimate_fundamental, raising=False)
    monkeypatch.setattr(epiprior, "rank_matches", rank_matches, raising=False)
    monkeypatch.setattr(epiprior, "standard_matches", standard_matches, raising=False)
    return calls, state


@pytest.fixture
def images(tmp_path):
    return [save(tmp_path / f"{name}.png", texture(1024, 768, seed)) for seed, name in enumerate("ab")]


def test_estimate_as_json(library):
    calls, _ = library
    result = run("estimate", "a.jpg", "b.jpg", "--json", "--estimator", "prosac", "--seed", 5, "--threshold", 2.5)
    assert result.exit_code == 0
    assert result.stderr == ""
    printed = json.loads(result.stdout)
    assert list(printed) == KEYS
    np.testing.assert_array_equal(printed["F"], PAIR.F)
    assert printed["status"] == "ok"
    assert printed["support"] == PAIR.right.sum()
    assert printed["matches"] == len(PAIR.matches)
    assert (printed["spread"], printed["plausibility"]) == (41, 0.875)
    assert printed["preset"] == "default"
    assert printed["seed"] == 5
    assert printed["seconds"] == {"estimator": 0.25}
    assert calls["estimate"] == {
        "images": (Path("a.jpg"), Path("b.jpg")),
        "estimator": "prosac",
        "mode": "preprocess",
        "settings": find_preset("default"),
        "seed": 5,
        "threshold_px": 2.5,
    }


def test_estimate_without_preprocessing(library):
    calls, state = library
    state["estimate"] = estimate_of(input="standard")
    printed = json.loads(run("estimate", "a", "b", "--mode=standard").stdout)
    assert calls["estimate"]["mode"] == "standard"
    assert (printed["input"], printed["preset"]) == ("standard", None)


def test_estimate_with_a_mode(library):
    calls, _ = library
    printed = json.loads(run("estimate", "a", "b", "--mode", "cascade").stdout)
    assert calls["estimate"]["mode"] == "cascade"
    assert (printed["input"], printed["preset"]) == ("default", "default")
    assert "default matches; roll" in run("estimate", "a", "b", "--mode", "cascade", "--text").stdout
    assert run("estimate", "a", "b", "--mode", "waterfall").exit_code == 2


def test_estimate_as_text(library):
    result = run("estimate", "a", "b", "--text")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    about = f"usac: ok, support {PAIR.right.sum()} of {len(PAIR.matches)} matches"
    assert lines[0] == f"{about} in 41 cells, plausibility 0.88"
    np.testing.assert_allclose([[float(v) for v in line.split()] for line in lines[1:4]], PAIR.F, rtol=1e-9)


def test_an_unknown_plausibility_is_null_and_left_out_of_the_text(library):
    library[1]["estimate"] = estimate_of(plausibility=float("nan"))
    assert json.loads(run("estimate", "a", "b", "--json").stdout)["plausibility"] is None
    assert "plausibility" not in run("estimate", "a", "b", "--text").stdout


@pytest.mark.parametrize("status", [Status.TOO_FEW_MATCHES, Status.NO_MODEL, Status.DEGENERATE])
def test_no_geometry_is_exit_code_1(library, status):
    library[1]["estimate"] = estimate_of(status, "the reason", roll_deg=float("nan"), iterations=None)
    result = run("estimate", "a", "b", "--json")
    assert result.exit_code == 1
    printed = json.loads(result.stdout)
    assert (printed["status"], printed["F"], printed["message"]) == (status.value, None, "the reason")
    assert printed["roll_deg"] is None
    assert one_line(result) == f"epiprior: no fundamental matrix: {status.value}: the reason"
    assert run("estimate", "a", "b", "--text").exit_code == 1


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ImageError("a.jpg: no such image file"), "epiprior: error: a.jpg: no such image file"),
        (ModelError("two\nlines"), "epiprior: error: two lines"),
        (OSError(errno.ENOSPC, "No space left on device"), "epiprior: error: No space left on device"),
        (PermissionError(errno.EACCES, "Permission denied", "/x/y"), "epiprior: error: /x/y: Permission denied"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(library, error, line):
    library[1]["estimate"] = error
    result = run("estimate", "a", "b")
    assert result.exit_code == 2
    assert one_line(result) == line
    assert result.stdout == ""


def test_a_bug_keeps_its_traceback(library):
    library[1]["estimate"] = ZeroDivisionError("a bug")
    assert isinstance(run("estimate", "a", "b").exception, ZeroDivisionError)


def test_library_messages_go_to_stderr(library, monkeypatch):
    def compiling(*args, **options):
        logging.getLogger("epiprior.rank").info("compiling kernels")
        logging.getLogger("epiprior.rank").debug("detail")
        return estimate_of()

    monkeypatch.setattr(epiprior, "estimate_fundamental", compiling)
    for _ in range(2):
        result = run("estimate", "a", "b")
        assert one_line(result) == "epiprior: compiling kernels"
        assert json.loads(result.stdout)["status"] == "ok"
    assert run("--quiet", "estimate", "a", "b").stderr == ""
    assert logging.getLogger("epiprior").handlers == []


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_match_writes_all_sets(library, tmp_path, suffix):
    calls, _ = library
    out = tmp_path / f"matches.{suffix}"
    result = run("match", "a", "b", "--out", out, "--preset", "paper")
    assert result.exit_code == 0
    assert calls["rank"]["settings"] == find_preset("paper")
    assert [s.roll_deg for s in read_matches(out)] == [0.0, 90.0]
    assert str(len(PAIR.matches)) in result.stdout


def test_match_without_any(library, images, tmp_path):
    library[1]["sets"] = (PAIR.matches.take(slice(0, 0)),)
    result = run("match", *images, "--out", tmp_path / "m.csv")
    assert result.exit_code == 1
    assert one_line(result).startswith("epiprior: no matches")


@pytest.mark.parametrize(
    ("command", "name"), [("match", "m.txt"), ("match", "no/m.csv"), ("draw", "f.gif"), ("draw", "no/f.png")]
)
def test_outputs_are_checked_before_the_work(library, tmp_path, command, name):
    calls, _ = library
    result = run(command, "a", "b", "--out", tmp_path / name)
    assert result.exit_code == 2
    assert str(tmp_path / name) in one_line(result)
    assert calls == {}


def test_draw(library, images, tmp_path):
    calls, state = library
    state["estimate"] = estimate_of(roll_deg=90.0)
    state["sets"] = (make_matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0)), state["sets"][1])
    result = run("draw", *images, "--out", tmp_path / "f.png")
    assert result.exit_code == 0, result.stderr
    assert calls["estimate"]["ranked"].sets == state["sets"]
    figure = cv2.imread(str(tmp_path / "f.png")).astype(int)
    assert figure.shape[1] == 2056
    # The set of the winning roll is drawn, not the empty one.
    assert (np.ptp(figure[150:800], axis=2) > 60).sum() > 5000


def test_draw_without_geometry_still_draws(library, images, tmp_path):
    calls, state = library
    state["estimate"] = estimate_of(Status.NO_MODEL, "nothing fits")
    result = run("draw", *images, "--out", tmp_path / "f.png", "--mode=standard")
    assert result.exit_code == 1
    assert (tmp_path / "f.png").exists()
    assert calls["standard"]
    assert calls["estimate"]["ranked"] is None


def test_colmap(library, images, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    result = run("colmap", *images, "--database", tmp_path / "out.db")
    assert result.exit_code == 0, result.stderr
    with pycolmap.Database.open(tmp_path / "out.db") as database:
        assert database.num_verified_image_pairs() == 1
    again = run("colmap", *images, "--database", tmp_path / "out.db")
    assert again.exit_code == 2
    assert "out.db: exists already" in one_line(again)


def test_colmap_without_geometry(library, images, tmp_path):
    pytest.importorskip("pycolmap")
    library[1]["estimate"] = estimate_of(Status.DEGENERATE, "a plane")
    result = run("--quiet", "colmap", *images, "--database", tmp_path / "out.db")
    assert result.exit_code == 1
    assert "degenerate" in one_line(result)
    assert run("colmap", images[0], "--database", tmp_path / "one.db").exit_code == 2


def test_estimators():
    result = run("estimators")
    assert result.exit_code == 0
    assert "usac" in result.stdout
    rows = {row["name"]: row for row in json.loads(run("estimators", "--json").stdout)}
    assert rows["usac"] == {"name": "usac", "available": True, "status": "available", "licence": "Apache-2.0"}
    assert set(rows) == set(epiprior.list_estimators())
    assert all(row["licence"] for row in rows.values())


def test_info_of_nothing(tmp_path):
    for name in ("nothing", "no/folder", tmp_path):
        result = run("info", name)
        assert result.exit_code == 2
        assert str(name) in one_line(result)


def test_help_and_version():
    for arguments in (["--help"], *([name, "--help"] for name in ("match", "estimate", "draw", "info", "colmap"))):
        result = run(*arguments)
        assert result.exit_code == 0
        assert "epiprior" in result.stdout or arguments == ["--help"]
    assert run("--version").stdout.startswith("epiprior 0.")
    assert run("estimate", "a").exit_code == 2
    assert run("estimate", "a", "b", "--seed", "-1").exit_code == 2


def in_process(*arguments, **options):
    command = [sys.executable, "-W", "error", "-m", "epiprior.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)


def test_help_imports_nothing_slow():
    code = (
        "import sys; from epiprior.cli import app\n"
        "try: app(['--help'])\n"
        "except SystemExit: pass\n"
        "print({m.split('.')[0] for m in sys.modules} & {'numpy', 'numba', 'cv2', 'scipy', 'onnxruntime'})"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.splitlines()[-1] == "set()"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("arguments", [["estimators", "--json"], ["--version"]])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_full_standard_output(arguments, unbuffered):
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "epiprior.cli", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
        )
    assert result.returncode == 2
    assert result.stderr == "epiprior: error: No space left on device\n"


# From here on the library itself runs, with a model made by hand.


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return make_model(tmp_path_factory.mktemp("models") / "default")


@pytest.fixture
def with_model(model, monkeypatch):
    monkeypatch.setattr("epiprior.ranking.models.find_model", lambda name: model)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Files by name: a good pair, and everything that users hand in by mistake."""
    folder = tmp_path_factory.mktemp("photographs")
    left, right = relief_pair(360, 270)
    (folder / "text.jpg").write_text("not a picture")
    (folder / "folder.jpg").mkdir()
    whole = save(folder / "whole.png", left).read_bytes()
    (folder / "cut.png").write_bytes(whole[:20])
    return {
        "left": save(folder / "left.png", left),
        "right": save(folder / "right.png", right),
        **{
            name: save(folder / f"{name}.png", x)
            for name, x in zip(("small1", "small2"), relief_pair(240, 180), strict=True)
        },
        "black": save(folder / "black.png", np.zeros((200, 300), np.uint8)),
        "tiny": save(folder / "tiny.png", texture(10, 10)),
        "text": folder / "text.jpg",
        "missing": folder / "missing.jpg",
        "folder": folder / "folder.jpg",
        "cut": folder / "cut.png",
        "long": folder / f"{'x' * 300}.jpg",
        "narrow": save(folder / "narrow.png", texture(1, 300)),
    }


def assert_rows_correspond(F, x1):
    """The cameras of the good pairs stand side by side: (F x1) is the row of x1, here at the column 200."""
    lines = np.column_stack([x1, np.ones(len(x1))]) @ np.array(F).T
    rows = -(lines[:, 0] * 200 + lines[:, 2]) / lines[:, 1]
    np.testing.assert_allclose(rows, np.array(x1)[:, 1], atol=1.5)


@pytest.mark.parametrize("how", ["--mode=preprocess", "--mode=standard", "--mode=cascade"])
def test_a_good_pair(with_model, photographs, how):
    result = run("estimate", photographs["left"], photographs["right"], how, "--json")
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert printed["status"] == "ok"
    assert printed["support"] > 300
    assert_rows_correspond(printed["F"], [(100, 50), (300, 250)])


@pytest.mark.parametrize("name", list(epiprior.list_estimators()))
def test_every_estimator_on_a_good_pair(with_model, photographs, name):
    state = epiprior.list_estimators()[name]
    result = run("estimate", photographs["small1"], photographs["small2"], "--estimator", name, "--json")
    if state != "available":
        assert (result.exit_code, result.stdout) == (2, "")
        assert state in one_line(result)
        return
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert (printed["estimator"], printed["status"]) == (name, "ok")
    assert printed["support"] > 100
    assert_rows_correspond(printed["F"], [(60, 30), (200, 160)])


def test_the_same_seed_gives_the_same_json(with_model, photographs):
    first, second = (
        json.loads(run("estimate", photographs["left"], photographs["right"], "--seed", 3).stdout) for _ in "ab"
    )
    del first["seconds"], second["seconds"]
    assert first == second


BAD = [
    ("left", "missing", 2, "missing.jpg"),
    ("text", "right", 2, "text.jpg"),
    ("folder", "right", 2, "folder.jpg: is a folder"),
    ("left", "long", 2, "xxxx.jpg"),
    ("narrow", "right", 1, "too_few_matches"),
    ("black", "right", 1, "too_few_matches"),
    ("left", "tiny", 1, "too_few_matches"),
    ("left", "left", 1, "degenerate"),
]


@pytest.mark.parametrize(("name1", "name2", "code", "words"), BAD)
@pytest.mark.parametrize("how", ["--mode=preprocess", "--mode=standard"])
def test_bad_pairs(with_model, photographs, name1, name2, code, words, how):
    result = run("--quiet", "estimate", photographs[name1], photographs[name2], how, "--json")
    assert result.exit_code == code
    assert words in one_line(result)
    if code == 1:
        printed = json.loads(result.stdout)
        assert (printed["status"], printed["F"], printed["support"]) == (words, None, 0)
        assert printed["message"]
    else:
        assert result.stdout == ""


@pytest.mark.parametrize(("name1", "name2", "code", "words"), BAD)
def test_bad_pairs_for_match_and_draw(with_model, photographs, tmp_path, name1, name2, code, words):
    pair = (photographs[name1], photographs[name2])
    drawn = run("--quiet", "draw", *pair, "--out", tmp_path / "f.png")
    assert drawn.exit_code == code
    assert words in one_line(drawn)
    assert (tmp_path / "f.png").exists() == (code == 1)
    matched = run("--quiet", "match", *pair, "--out", tmp_path / "m.csv")
    # Identical images have matches, though no geometry.
    assert matched.exit_code == (0 if name1 == name2 else code)
    assert len(matched.stderr.splitlines()) == (0 if name1 == name2 else 1)
    assert (tmp_path / "m.csv").exists() == (code == 1)


def test_unknown_names(with_model, photographs):
    pair = (photographs["left"], photographs["right"])
    for option in ("--estimator", "--preset"):
        result = run("estimate", *pair, option, "nonsense")
        assert result.exit_code == 2
        assert "nonsense" in one_line(result)
    assert "threshold" in one_line(run("estimate", *pair, "--threshold", "-1"))


def test_what_is_not_installed(with_model, photographs, tmp_path, monkeypatch):
    for package in ("poselib", "pycolmap"):
        monkeypatch.setitem(sys.modules, package, None)
    pair = (photographs["left"], photographs["right"])
    for arguments, words in (
        (["estimate", *pair, "--estimator", "prosac"], 'prosac is not installed: pip install "epiprior[poselib]"'),
        (["draw", *pair, "--estimator", "prosac", "--out", tmp_path / "f.png"], "prosac is not installed"),
        (["colmap", *pair, "--database", tmp_path / "new.db"], "needs pycolmap: pip install 'pycolmap>=4,<5'"),
    ):
        result = run("--quiet", *arguments)
        assert result.exit_code == 2
        assert words in one_line(result)
    assert not list(tmp_path.iterdir())


def test_match_writes_probabilities(with_model, photographs, tmp_path):
    result = run("match", photographs["left"], photographs["right"], "--out", tmp_path / "m.npz")
    assert result.exit_code == 0, result.stderr
    best = read_matches(tmp_path / "m.npz")[0]
    assert len(best) > 300
    assert (np.diff(best.probability) <= 0).all()
    assert np.median(np.abs(best.x1 - best.x2)[:200, 1]) < 1


def test_draw_a_good_pair(with_model, photographs, tmp_path):
    result = run("draw", photographs["left"], photographs["right"], "--out", tmp_path / "f.jpg")
    assert result.exit_code == 0, result.stderr
    assert cv2.imread(str(tmp_path / "f.jpg")).shape[1] > 900


def test_info(model):
    result = run("info", f"{model}{os.sep}")
    assert result.exit_code == 0, result.stderr
    for words in ("similarity_main", "0.125", "onnx", "0" * 30):
        assert words in result.stdout
    printed = json.loads(run("info", model, "--json").stdout)
    assert printed["match"]["features"][0] == "supporting_matrices"
    assert printed["folder"] == str(model)


@pytest.mark.parametrize("file", ["match.onnx", "two_keypoint.onnx", "manifest.json", "README.md"])
def test_a_damaged_model(model, tmp_path, monkeypatch, photographs, file):
    damaged = tmp_path / "default"
    shutil.copytree(model, damaged)
    (damaged / file).write_bytes((damaged / file).read_bytes()[:-20] + b"damage")
    monkeypatch.setattr("epiprior.ranking.models.find_model", lambda name: damaged)
    for arguments in (["info", damaged], ["estimate", photographs["left"], photographs["right"], "--json"]):
        result = run("--quiet", *arguments)
        assert result.exit_code == 2
        assert file in one_line(result)
        assert result.stdout == ""


def test_exit_codes_of_the_real_program(photographs, tmp_path):
    good = in_process("estimate", photographs["left"], photographs["right"], "--mode=standard", "--json")
    assert (good.returncode, json.loads(good.stdout)["status"]) == (0, "ok")
    same = in_process("--quiet", "estimate", photographs["left"], photographs["left"], "--mode=standard")
    assert (same.returncode, json.loads(same.stdout)["status"]) == (1, "degenerate")
    assert same.stderr.startswith("epiprior: no fundamental matrix: degenerate")
    for arguments in (
        ("estimate", photographs["missing"], photographs["left"], "--mode=standard"),
        ("estimate", photographs["cut"], photographs["left"], "--mode=standard"),  # of which OpenCV warns as well
        ("info", tmp_path),
        ("match", photographs["left"], photographs["right"], "--out", tmp_path / "no" / "m.csv"),
    ):
        bad = in_process("--quiet", *arguments)
        assert bad.returncode == 2
        assert bad.stdout == ""
        assert bad.stderr.startswith("epiprior: error: ")
        assert bad.stderr.count("\n") == 1
