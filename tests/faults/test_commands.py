"""What other people's files, pipes and databases do to the commands: checked first, named, or worked around."""

import sqlite3
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import epiprior
from command_line import FakeLibrary
from command_line import run_command as run
from epiprior import FeatureError
from epiprior.io import read_colmap_features
from pictures import save, texture


def test_output_closed_early_is_said():
    command = [sys.executable, "-m", "epiprior.cli", "estimators"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        program.stdout.close()
        assert program.stderr.read() == "epiprior: the output was closed early; the work goes on without it\n"
    assert program.returncode == 0


@pytest.mark.parametrize("command", ["estimate", "match", "draw"])
def test_working_size_and_features_are_set_on_the_command_line(tmp_path, monkeypatch, command):
    library = FakeLibrary(monkeypatch)
    out = {"match": ["--out", tmp_path / "m.csv"], "draw": ["--out", tmp_path / "f.png"]}
    images = [save(tmp_path / f"Photo {i} of 2.png", texture(1024, 768, i)) for i in (1, 2)]
    call = (command, *images, *out.get(command, []))
    options = ["--max-image-size", 512, "--features", "colmap-sift", "--max-features", 100, "--preset", "paper"]
    result = run(*call, *options)
    assert result.exit_code == 0, result.output
    settings = [given["settings"] for _, given in library.calls if "settings" in given][-1]
    paper = epiprior.presets.find_preset("paper")
    wanted = replace(paper.features, max_image_size=512, detector="colmap-sift", max_keypoints=100)
    assert settings == replace(paper, features=wanted)
    small = run(*call, "--max-image-size", 5)
    assert small.exit_code == 2
    assert "max_image_size is 5, must" in small.stderr
    assert run(*call, "--features", "orb").exit_code == 2


@pytest.mark.parametrize("table", ["keypoints", "descriptors"])
def test_a_database_with_cut_numbers_names_image_and_sizes(tmp_path, table):
    pycolmap = pytest.importorskip("pycolmap")
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        camera = database.write_camera(pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 300.0, 300, 200))
        image = database.write_image(pycolmap.Image(name="a b.jpg", camera_id=camera))
        database.write_keypoints(image, np.ones((3, 4), np.float32))
        kind = pycolmap.FeatureExtractorType.SIFT
        database.write_descriptors(image, pycolmap.FeatureDescriptors(kind, np.ones((3, 128), np.uint8)))
    with sqlite3.connect(tmp_path / "a.db") as opened:
        opened.execute(f"UPDATE {table} SET data = x'0102030405'")
    expected = {"keypoints": 48, "descriptors": 384}[table]
    with pytest.raises(FeatureError, match=rf"image 'a b.jpg': its {table} hold 5 bytes, expected {expected}: 3 rows"):
        read_colmap_features(tmp_path / "a.db", "a b.jpg")
