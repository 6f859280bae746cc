import logging
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from collections_fakes import FakeEstimation, in_this_process, rows_of, small_images, views
from command_line import one_line, refused
from command_line import run_command as run
from epiprior import Status
from epiprior.collection.model import map_beside
from epiprior.collection.verify import judge_pairs
from epiprior.collection.workers import WorkerLostError
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.presets import find_preset
from feature_files import extract_colmap, hloc_parts, write_h5

pycolmap = pytest.importorskip("pycolmap")


@pytest.fixture
def estimation(monkeypatch):
    return in_this_process(monkeypatch)


@pytest.fixture
def images(tmp_path):
    small_images(tmp_path / "set", ("Photo 1.png", "Photo 2.png", "Photo 3.png"))
    return tmp_path / "set"


def test_colmap(estimation, images, tmp_path):
    result = run("colmap", images, "--database", tmp_path / "out.db", "--max-features", 200)
    assert result.exit_code == 0, result.stderr
    assert f"{tmp_path / 'out.db'}: 3 of 3 pairs have a geometry" in result.stdout
    assert "pairs: 3 of 3" in result.stderr
    assert [row[1] for row in rows_of(tmp_path / "out.db", "images")["images"]] == [
        "Photo 1.png",
        "Photo 2.png",
        "Photo 3.png",
    ]
    again = refused("colmap", images, "--database", tmp_path / "out.db")
    assert "out.db: exists already, but Photo 1.png has no descriptors" in again
    assert "exists already" in refused("colmap", *images.iterdir(), "--database", tmp_path / "out.db")
    assert run("colmap", "--database", tmp_path / "new.db").exit_code == 2
    assert run("colmap", images / "Photo 1.png", "--database", tmp_path / "new.db").exit_code == 2


def test_known_focal_lengths_decide_with(tmp_path):
    folder = views(tmp_path / "set", 3)
    known = ("--mode=standard", "--workers=1", "--camera-model=SIMPLE_PINHOLE", "--camera-params=600,240,150")
    assert run("colmap", folder, "--database", tmp_path / "out.db", *known).exit_code == 0
    with pycolmap.Database.open(tmp_path / "out.db") as database:
        geometry = database.read_two_view_geometry(1, 2)
    assert geometry.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED.value
    assert abs(np.linalg.det(geometry.E)) < 1e-6
    extract_colmap(tmp_path / "filled.db", folder)
    with pycolmap.Database.open(tmp_path / "filled.db") as database:
        for camera in database.read_all_cameras():
            camera.has_prior_focal_length = True
            database.update_camera(camera)
    late = run("colmap", folder, "--database", tmp_path / "filled.db", known[-1])
    assert late.exit_code == 2
    assert "too late" in late.stderr
    assert run("colmap", folder, "--database", tmp_path / "filled.db", *known[:2]).exit_code == 0
    with pycolmap.Database.open(tmp_path / "filled.db") as database:
        assert database.read_two_view_geometry(1, 2).config == geometry.config


def test_a_mapper_that_crashes_is_asked_again(tmp_path, monkeypatch, caplog):
    seeds = []

    def crash_once(pool, function, jobs):
        ((_, (*_, seed, _)),) = jobs
        seeds.append(seed)
        if len(seeds) < 2:
            raise WorkerLostError("as the test wants")
        return [(0, [])]

    monkeypatch.setattr("epiprior.collection.model.run_tasks", crash_once)
    assert map_beside(tmp_path / "a.db", tmp_path, tmp_path / "sparse", 5) == []
    assert seeds == [5, 6]
    assert "with seed 5" in caplog.text
    monkeypatch.setattr("epiprior.collection.model._TRIES", 1)
    seeds.clear()
    with pytest.raises(WorkerLostError, match=r"a\.db is complete"):
        map_beside(tmp_path / "a.db", tmp_path, tmp_path / "sparse", 5)


@pytest.mark.parametrize(("given", "trusted"), [(True, True), (True, False), (False, True)])
def test_given_focal_lengths_stay_unless_pairs_contradict(estimation, images, tmp_path, monkeypatch, given, trusted):
    def mapped(database, *_, refine):
        with pycolmap.Database.open(database) as opened:
            mapping.append((refine, {camera.has_prior_focal_length for camera in opened.read_all_cameras()}))
        return []

    mapping = []
    monkeypatch.setattr(
        "epiprior.collection.verify.judge_pairs", lambda *of: replace(judge_pairs(*of), trusted=trusted)
    )
    monkeypatch.setattr("epiprior.collection.model.map_beside", mapped)
    options = ["--camera-params=600,240,150,0"] if given else []
    assert run("sfm", images, "--out", tmp_path / "scene", *options).exit_code == 1
    assert mapping == [(not (given and trusted), {given and trusted})]


def test_without_geometry_or_model_it_is_said_why(images, tmp_path, monkeypatch):
    in_this_process(monkeypatch, FakeEstimation(Status.DEGENERATE))
    result = run("--quiet", "colmap", images, "--database", tmp_path / "out.db")
    assert result.exit_code == 1
    assert one_line(result).endswith("Photo 1.png, Photo 2.png: degenerate: as the test wants")
    result = run("--quiet", "sfm", images, "--out", tmp_path / "scene")
    assert result.exit_code == 1
    assert "no model" in one_line(result)
    page = (tmp_path / "scene" / "report.html").read_text()
    assert page.count("no: no pair has a geometry") == 3
    assert "not written: degenerate" in page


def test_colmap_adds_to_a_database(estimation, images, tmp_path):
    extract_colmap(tmp_path / "out.db", images)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("Photo 1.png Photo 2.png\n")
    result = run("--quiet", "colmap", "--database", tmp_path / "out.db", "--pairs", pairs, "--work", tmp_path / "w")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "1 of 1 pairs" in result.stdout
    assert "2 of 2 pairs" in run("colmap", images, "--database", tmp_path / "out.db").stdout
    nothing = run("--quiet", "colmap", images, "--database", tmp_path / "out.db")
    assert (nothing.exit_code, nothing.stderr) == (0, "")
    assert "0 of 0 pairs" in nothing.stdout
    assert len(estimation.calls) == 3


@pytest.mark.parametrize("command", ["colmap", "sfm"])
@pytest.mark.parametrize("kind", ["missing", "unreadable", "doubled"])
def test_all_images_are_checked_before_the_work(estimation, images, tmp_path, command, kind):
    files, bad = sorted(images.iterdir()), tmp_path / "last.jpg"
    if kind == "unreadable":
        bad.write_text("not a picture")
    elif kind == "doubled":
        bad = files[0]
    out = ({"colmap": "--database", "sfm": "--out"}[command], tmp_path / "o.db")
    assert bad.name in refused(command, *files, bad, *out)
    assert not list(tmp_path.glob("o*"))


def test_options_reach_the_estimation(estimation, images, tmp_path):
    options = ["--max-image-size", 128, "--features", "colmap-sift", "--max-features", 100, "--preset", "paper"]
    options += ["--mode", "standard", "--estimator", "usac", "--seed", 5, "--threshold", 2.5, "--pairs", "sequential:1"]
    assert run("colmap", images, "--database", tmp_path / "out.db", *options).exit_code == 0
    assert len(estimation.calls) == 2
    call, paper = estimation.calls[0], find_preset("paper")
    wanted = replace(paper.features, max_image_size=128, detector="colmap-sift", max_keypoints=100)
    assert call["settings"] == replace(paper, features=wanted)
    named = {"mode": "standard", "estimator": "usac", "seed": 5, "threshold_px": 2.5}
    assert {name: call[name] for name in named} == named
    small = run("colmap", images, "--database", tmp_path / "new.db", "--max-image-size", 5)
    assert "max_image_size is 5, must" in one_line(small)


def test_hloc(estimation, images, tmp_path):
    h5py = pytest.importorskip("h5py")
    parts = {path.name: hloc_parts(detect_features(load_photograph(path))) for path in images.iterdir()}
    write_h5(tmp_path / "feats.h5", parts)
    command = ("--quiet", "hloc", images, "--features", tmp_path / "feats.h5", "--matches", tmp_path / "matches.h5")
    result = run(*command, "--roots", 0)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "3 of 3 pairs have a geometry" in result.stdout
    with h5py.File(tmp_path / "matches.h5") as file:
        assert list(file["Photo 1.png"]) == ["Photo 2.png", "Photo 3.png"]
    assert "matches.h5: exists already" in one_line(run(*command))


@pytest.mark.slow
def test_from_a_folder_to_a_model(tmp_path, caplog):
    folder = views(tmp_path / "set")
    shutil.copy(folder / "0.png", folder / "copy.png")
    command = ("sfm", folder, "--out", tmp_path / "scene", "--mode=standard", "--camera-mode=single", "--workers=1")
    with caplog.at_level(logging.INFO, "epiprior"):
        result = run(*command)
    assert result.exit_code == 0, result.stderr
    model = pycolmap.Reconstruction(tmp_path / "scene" / "sparse" / "0")
    assert model.num_reg_images() >= 4
    assert model.num_points3D() > 200
    assert (tmp_path / "scene" / "sparse" / "0" / "points.ply").read_bytes().startswith(b"ply")
    page = (tmp_path / "scene" / "report.html").read_text()
    assert "copy.png" in page
    assert "the same bytes as 0.png" in page
    assert f"{model.num_reg_images()} of 5 images are registered" in page
    # The same again: nothing is matched anew, and the model is the same.
    binary = (tmp_path / "scene" / "sparse" / "0" / "points3D.bin").read_bytes()
    assert run(*command).exit_code == 0
    assert (tmp_path / "scene" / "sparse" / "0" / "points3D.bin").read_bytes() == binary
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("")
    assert "is neither empty nor made by this command" in one_line(run("sfm", folder, "--out", tmp_path / "other"))


KILLS = int(os.environ.get("EPIPRIOR_KILLS", "3"))


@pytest.mark.slow
def test_killed_at_random_moments_and_started_again_it_writes_the_same(tmp_path):
    """EPIPRIOR_KILLS sets how many moments are tried."""
    folder, killed = views(tmp_path / "set"), 0
    command = [sys.executable, "-m", "epiprior.cli", "--quiet", "colmap", str(folder), "--mode", "standard"]
    start = time.monotonic()
    subprocess.run([*command, "--database", str(tmp_path / "whole.db")], check=True)
    seconds, whole = time.monotonic() - start, rows_of(tmp_path / "whole.db")
    assert len(whole["two_view_geometries"]) > 5
    for number, moment in enumerate(np.random.default_rng(KILLS).uniform(0.3, 1, KILLS) * seconds):
        path = tmp_path / f"{number}.db"
        with subprocess.Popen([*command, "--database", str(path)]) as running:
            try:
                running.wait(moment)
            except subprocess.TimeoutExpired:
                running.kill()
                killed += 1
        if not path.exists():  # it is there as a whole, or not at all
            subprocess.run([*command, "--database", str(path)], check=True)
        assert rows_of(path) == whole
    assert killed
