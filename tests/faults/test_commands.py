"""What other people's files, pipes and databases do to the commands: checked first, named, or worked around."""

import sqlite3
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import typer

import epiprior
from command_line import FakeLibrary, one_line
from command_line import run_command as run
from epiprior import FeatureError
from epiprior.io import read_colmap_features
from pictures import save, texture, turned_jpeg


@pytest.fixture
def library(monkeypatch):
    return FakeLibrary(monkeypatch)


@pytest.fixture
def images(tmp_path):
    return [save(tmp_path / f"Photo {i} of 3.png", texture(1024, 768, i)) for i in (1, 2, 3)]


def database_names(path):
    with sqlite3.connect(path) as opened:
        return sorted(name for (name,) in opened.execute("SELECT name FROM images"))


def test_colmap_holds_names_with_spaces_and_finds_features_once(library, images, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    detect, found = epiprior.features.detect.detect_features, []
    monkeypatch.setattr("epiprior.features.detect.detect_features", lambda *a: found.append(detect(*a)) or found[-1])
    result = run("colmap", *images, "--database", tmp_path / "out.db", "--max-features", 200)
    assert result.exit_code == 0, result.stderr
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["1/3", "2/3", "3/3"]
    assert database_names(tmp_path / "out.db") == [image.name for image in images]
    calls = [options for _, options in library.calls]
    assert [id(call[f"features{k}"]) for k in (1, 2) for call in calls] == [id(found[i]) for i in (0, 0, 1, 1, 2, 2)]
    assert all(not photograph.described for call in calls for photograph in call["images"])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("turned", "turned by its EXIF orientation"),
        ("missing", "no such image file"),
        ("doubled", "is given twice"),
        ("unreadable", "not an image"),
        ("not UTF-8", "a COLMAP database cannot hold it"),
    ],
)
def test_colmap_checks_all_images_before_the_work(library, images, tmp_path, kind, words):
    pytest.importorskip("pycolmap")
    bad = tmp_path / "last.jpg"
    if kind == "turned":
        turned_jpeg(bad)
    elif kind == "doubled":
        bad = images[0].parent / "." / images[0].name
    elif kind == "unreadable":
        bad.write_text("not a picture")
    elif kind == "not UTF-8":
        bad = tmp_path / b"caf\xe9.png".decode(errors="surrogateescape")
        bad.write_bytes(images[0].read_bytes())
    result = run("colmap", *images, bad, "--database", tmp_path / "out.db")
    assert result.exit_code == 2, result.output
    assert bad.name.encode(errors="backslashreplace").decode() in one_line(result)
    assert words in one_line(result)
    assert library.calls == []
    assert not (tmp_path / "out.db").exists()


def test_files_that_macos_leaves_are_left_out_and_it_is_said_once(library, images, tmp_path):
    pytest.importorskip("pycolmap")
    copies = [image.with_name(f"._{image.name}") for image in images]
    for copy in copies:
        copy.write_bytes(b"\0\5\x16\7")
    result = run("--quiet", "colmap", *images, *copies, "--database", tmp_path / "out.db")
    assert result.exit_code == 0, result.stderr
    assert one_line(result).startswith("epiprior: left out 3 files named ._*")
    assert len(database_names(tmp_path / "out.db")) == 3


def test_colmap_finishes_where_its_output_is_closed_early(library, images, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    echo = typer.echo

    def closed(text="", **options):
        if not options.get("err"):
            raise BrokenPipeError(32, "Broken pipe")
        echo(text, **options)

    monkeypatch.setattr(typer, "echo", closed)
    result = run("--quiet", "colmap", *images, "--database", tmp_path / "out.db")
    assert result.exit_code == 0
    assert "the output was closed early" in result.stderr
    assert len(database_names(tmp_path / "out.db")) == 3


def test_output_closed_early_is_said():
    command = [sys.executable, "-m", "epiprior.cli", "estimators"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        program.stdout.close()
        assert program.stderr.read() == "epiprior: the output was closed early; the work goes on without it\n"
    assert program.returncode == 0


@pytest.mark.parametrize("command", ["estimate", "match", "draw", "colmap"])
def test_working_size_and_features_are_set_on_the_command_line(library, images, tmp_path, command):
    pytest.importorskip("pycolmap")
    out = {"match": ["--out", tmp_path / "m.csv"], "draw": ["--out", tmp_path / "f.png"]}
    rest = out.get(command, ["--database", tmp_path / "out.db"] if command == "colmap" else [])
    options = ["--max-image-size", 512, "--features", "colmap-sift", "--max-features", 100, "--preset", "paper"]
    result = run(command, *images[:2], *rest, *options)
    assert result.exit_code == 0, result.output
    settings = [given["settings"] for _, given in library.calls if "settings" in given][-1]
    paper = epiprior.presets.find_preset("paper")
    wanted = replace(paper.features, max_image_size=512, detector="colmap-sift", max_keypoints=100)
    assert settings == replace(paper, features=wanted)
    small = run(command, *images[:2], *(str(a).replace("out.db", "new.db") for a in rest), "--max-image-size", 5)
    assert small.exit_code == 2
    assert "max_image_size is 5, must" in small.stderr
    assert run(command, *images[:2], *rest, "--features", "orb").exit_code == 2


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
