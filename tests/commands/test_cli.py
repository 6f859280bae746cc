import errno
import json
import logging
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import epiprior
from command_line import PAIR, FakeLibrary, one_line, refused, run_python
from command_line import run_command as run
from epiprior import ImageError, ModelError, Status
from epiprior.presets import find_preset
from epiprior.types import Geometry
from pictures import relief_pair, save, texture
from synthetic import make_estimate, make_matches
from tables import read_table

KEYS = "status confidence geometry F H support matches iterations estimator version input preset roll_deg seed"


def estimate_of(status=Status.OK, message="", **changes):
    known = {"iterations": 17, "seconds": {"estimator": 0.25}, "confidence": 0.875, "geometry": Geometry.GENERAL}
    return make_estimate(PAIR, status, message=message, **(known | changes))


@pytest.fixture
def library(monkeypatch):
    fake = FakeLibrary(monkeypatch)
    fake.estimate, fake.sets = estimate_of(), (PAIR.matches, replace(PAIR.matches, roll_deg=90.0))
    return fake


@pytest.fixture
def images(tmp_path):
    return [save(tmp_path / f"{name}.png", texture(1024, 768, seed)) for seed, name in enumerate("ab")]


def test_estimate_as_json_as_text_and_with_an_unknown_confidence(library):
    options = ("--estimator", "prosac", "--seed", 5, "--threshold", 2.5, "--min-confidence", 0.4)
    result = run("estimate", "a.jpg", "b.jpg", "--json", *options)
    assert (result.exit_code, result.stderr) == (0, "")
    printed = json.loads(result.stdout)
    assert list(printed) == [*KEYS.split(), "seconds", "message"]
    np.testing.assert_array_equal(printed["F"], PAIR.F)
    wanted = {"status": "ok", "support": PAIR.right.sum(), "matches": len(PAIR.matches), "geometry": "general"}
    wanted |= {"seed": 5, "confidence": 0.875, "preset": "default", "seconds": {"estimator": 0.25}}
    assert {name: printed[name] for name in wanted} == wanted
    asked = {"images": (Path("a.jpg"), Path("b.jpg")), "estimator": "prosac", "mode": "cascade", "seed": 5}
    asked |= {"settings": find_preset("default"), "threshold_px": 2.5, "min_confidence": 0.4}
    assert library.options() == asked
    result = run("estimate", "a", "b", "--text")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    support = f"support {PAIR.right.sum()} of {len(PAIR.matches)} matches"
    assert lines[0] == f"usac: ok, confidence 0.88, geometry general, {support}"
    assert [line[0] for line in lines[1:4]] == ["F", " ", " "]
    np.testing.assert_allclose([[float(v) for v in line[1:].split()] for line in lines[1:4]], PAIR.F, rtol=1e-9)
    library.estimate = estimate_of(confidence=float("nan"))
    assert json.loads(run("estimate", "a", "b", "--json").stdout)["confidence"] is None
    assert "confidence" not in run("estimate", "a", "b", "--text").stdout


@pytest.mark.parametrize(
    ("mode", "taken", "preset"),
    [("standard", "standard", None), ("cascade", "standard", None), ("cascade", "default", "default")],
)
def test_estimate_with_a_mode(library, mode, taken, preset):
    library.estimate = estimate_of(input=taken)
    printed = json.loads(run("estimate", "a", "b", "--mode", mode).stdout)
    assert library.options()["mode"] == mode
    assert (printed["input"], printed["preset"]) == (taken, preset)
    assert f"{taken} matches; roll" in run("estimate", "a", "b", "--mode", mode, "--text").stdout


@pytest.mark.parametrize("status", [Status.TOO_FEW_MATCHES, Status.NO_MODEL, Status.DEGENERATE])
def test_no_geometry_is_exit_code_1(library, status):
    library.estimate = estimate_of(status, "the reason", roll_deg=float("nan"), iterations=None)
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
        (ImageError("a.jpg: no such image file"), "a.jpg: no such image file"),
        (ModelError("two\nlines"), "two lines"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (PermissionError(errno.EACCES, "Permission denied", "/x/y"), "/x/y: Permission denied"),
    ],
)
def test_errors_are_one_line_and_exit_code_2_but_a_bug_keeps_its_traceback(library, error, line):
    library.estimate = error
    result = run("estimate", "a", "b")
    assert (result.exit_code, one_line(result), result.stdout) == (2, f"epiprior: error: {line}", "")
    library.estimate = ZeroDivisionError("a bug")
    assert isinstance(run("estimate", "a", "b").exception, ZeroDivisionError)


def test_library_messages_go_to_stderr(monkeypatch):
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


def test_match_writes_all_sets_and_says_where_there_are_none(library, images, tmp_path):
    result = run("match", "a", "b", "--out", tmp_path / "m.csv", "--preset", "paper")
    assert result.exit_code == 0
    assert library.options("rank_matches")["settings"] == find_preset("paper")
    assert [s.roll_deg for s in read_table(tmp_path / "m.csv")] == [0.0, 90.0]
    assert str(len(PAIR.matches)) in result.stdout
    library.sets = (PAIR.matches.take(slice(0, 0)),)
    result = run("match", *images, "--out", tmp_path / "m.csv")
    assert result.exit_code == 1
    assert one_line(result).startswith("epiprior: no matches")


@pytest.mark.parametrize("call", ["match m.txt", "match no/m.csv", "draw f.gif", "draw no/f.png"])
def test_outputs_are_checked_before_the_work(library, tmp_path, call):
    command, name = call.split()
    assert str(tmp_path / name) in refused(command, "a", "b", "--out", tmp_path / name)
    assert library.calls == []


def test_draw_shows_the_set_of_the_winning_roll_and_draws_without_geometry(library, images, tmp_path):
    library.estimate = estimate_of(roll_deg=90.0)
    library.sets = (make_matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0)), library.sets[1])
    result = run("draw", *images, "--out", tmp_path / "f.png")
    assert result.exit_code == 0, result.stderr
    assert library.options()["ranked"].sets == library.sets
    figure = cv2.imread(str(tmp_path / "f.png")).astype(int)
    assert figure.shape[1] == 2056
    assert (np.ptp(figure[150:800], axis=2) > 60).sum() > 5000
    library.calls.clear()
    library.estimate = estimate_of(Status.NO_MODEL, "nothing fits")
    result = run("draw", *images, "--out", tmp_path / "g.png", "--mode=standard")
    assert result.exit_code == 1
    assert (tmp_path / "g.png").exists()
    assert {name for name, _ in library.calls} == {"estimate_fundamental", "standard_matches"}
    assert library.options()["ranked"] is None


def test_estimators_and_models_are_listed(model_folder, tmp_path):
    assert "usac" in run("estimators").stdout
    rows = {row["name"]: row for row in json.loads(run("estimators", "--json").stdout)}
    assert rows["usac"] == {"name": "usac", "available": True, "status": "available", "licence": "Apache-2.0"}
    assert set(rows) == set(epiprior.list_estimators())
    result = run("info", f"{model_folder}{os.sep}")
    assert result.exit_code == 0, result.stderr
    for words in ("similarity_main", "0.125", "onnx", "0" * 30):
        assert words in result.stdout
    printed = json.loads(run("info", model_folder, "--json").stdout)
    assert printed["match"]["features"][0] == "supporting_matrices"
    assert printed["folder"] == str(model_folder)
    for name in ("nothing", "no/folder", tmp_path):
        assert str(name) in refused("info", name)


def test_help_version_and_usage_import_nothing_slow():
    for name in ("match", "estimate", "draw", "info", "sfm", "colmap", "hloc"):
        result = run(name, "--help")
        assert result.exit_code == 0
        assert name in result.stdout
    assert run("--version").stdout.startswith("epiprior 0.")
    for wrong in (["a"], ["a", "b", "--seed", "-1"], ["a", "b", "--mode", "waterfall"]):
        assert run("estimate", *wrong).exit_code == 2
    code = "import sys; from epiprior.cli import app\ntry: app(['--help'])\nexcept SystemExit: pass\n"
    slow = "{'numpy', 'numba', 'cv2', 'scipy', 'onnxruntime'}"
    code += f"print({{m.split('.')[0] for m in sys.modules}} & {slow})"
    assert run_python(code).stdout.splitlines()[-1] == "set()"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_full_standard_output(unbuffered):
    command = [sys.executable, "-m", "epiprior.cli", "--version"]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    assert (result.returncode, result.stderr) == (2, "epiprior: error: No space left on device\n")


# From here on the library itself runs, with a model made by hand.


@pytest.fixture
def with_model(model_folder, monkeypatch):
    monkeypatch.setattr("epiprior.ranking.models.find_model", lambda name: model_folder)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Files by name: a good pair, and everything that users hand in by mistake."""
    folder = tmp_path_factory.mktemp("photographs")
    left, right = relief_pair(360, 270)
    black, tiny, narrow = np.zeros((200, 300), np.uint8), texture(10, 10), texture(1, 300)
    pictures = {"left": left, "right": right, "black": black, "tiny": tiny, "narrow": narrow}
    files = {name: save(folder / f"{name}.png", picture) for name, picture in pictures.items()}
    names = {"text": "text.jpg", "missing": "missing.jpg", "folder": "folder.jpg", "cut": "cut.png"}
    files |= {name: folder / file for name, file in names.items()} | {"long": folder / f"{'x' * 300}.jpg"}
    files["text"].write_text("not a picture")
    files["folder"].mkdir()
    files["cut"].write_bytes(files["left"].read_bytes()[:20])
    return files


@pytest.mark.parametrize("how", ["--mode=preprocess", "--mode=standard", "--mode=cascade"])
def test_a_good_pair(with_model, photographs, how):
    result = run("estimate", photographs["left"], photographs["right"], how, "--json")
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert printed["status"] == "ok"
    assert printed["support"] > 300
    # The cameras stand side by side: the epipolar line of a point is its row, here at the column 200.
    lines = np.array([(100, 50, 1), (300, 250, 1)]) @ np.array(printed["F"]).T
    np.testing.assert_allclose(-(lines[:, 0] * 200 + lines[:, 2]) / lines[:, 1], [50, 250], atol=1.5)


@pytest.mark.parametrize(
    ("name1", "name2", "code", "words"),
    [
        ("left", "missing", 2, "missing.jpg"),
        ("text", "right", 2, "text.jpg"),
        ("folder", "right", 2, "folder.jpg: is a folder"),
        ("left", "long", 2, "xxxx.jpg"),
        ("narrow", "right", 1, "too_few_matches"),
        ("black", "right", 1, "too_few_matches"),
        ("left", "tiny", 1, "too_few_matches"),
        ("left", "left", 1, "degenerate"),
    ],
)
def test_bad_pairs(with_model, photographs, tmp_path, name1, name2, code, words):
    pair = (photographs[name1], photographs[name2])
    result = run("--quiet", "estimate", *pair, "--json")
    assert result.exit_code == code
    assert words in one_line(result)
    if code == 1:
        printed = json.loads(result.stdout)
        assert printed["status"] == words
        assert (printed["F"] is None, printed["support"] == 0) == (words == "too_few_matches",) * 2
        assert printed["message"]
    else:
        assert result.stdout == ""
    drawn = run("--quiet", "draw", *pair, "--out", tmp_path / "f.png")
    assert drawn.exit_code == code
    assert words in one_line(drawn)
    matched = run("--quiet", "match", *pair, "--out", tmp_path / "m.csv")
    # Identical images have matches, though no geometry.
    assert matched.exit_code == (0 if name1 == name2 else code)
    assert len(matched.stderr.splitlines()) == (0 if name1 == name2 else 1)
    assert len(list(tmp_path.iterdir())) == (2 if code == 1 else 0)


def test_unknown_names_and_what_is_not_installed(with_model, photographs, tmp_path, monkeypatch):
    pair = (photographs["left"], photographs["right"])
    for option in ("--estimator", "--preset"):
        assert "nonsense" in refused("estimate", *pair, option, "nonsense")
    assert "threshold" in refused("estimate", *pair, "--threshold", "-1")
    for package in ("poselib", "pycolmap"):
        monkeypatch.setitem(sys.modules, package, None)
    for arguments, words in (
        (["estimate", *pair, "--estimator", "prosac"], 'prosac is not installed: pip install "epiprior[poselib]"'),
        (["draw", *pair, "--estimator", "prosac", "--out", tmp_path / "f.png"], "prosac is not installed"),
        (["colmap", *pair, "--database", tmp_path / "new.db"], "needs pycolmap: pip install 'pycolmap>=4,<5'"),
        (["sfm", *pair, "--out", tmp_path / "scene"], "needs pycolmap: pip install 'pycolmap>=4,<5'"),
    ):
        assert words in refused("--quiet", *arguments)
    assert not list(tmp_path.iterdir())


def test_exit_codes_of_the_real_program(photographs):
    left, cut, black = (photographs[name] for name in ("left", "cut", "black"))
    for pair, code, status, words in (
        ((black, black), 1, "too_few_matches", "epiprior: no fundamental matrix: too_few_matches"),
        ((cut, left), 2, "", f"epiprior: error: {cut}"),  # of which OpenCV warns as well
    ):
        command = [sys.executable, "-W", "error", "-m", "epiprior.cli", "--quiet", "estimate", *pair, "--mode=standard"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == code
        assert (json.loads(done.stdout)["status"] if status else done.stdout) == status
        assert done.stderr.startswith(words)
        assert done.stderr.count("\n") == 1
