"""Tables and COLMAP databases: what is written is read back; what cannot be written says why."""

import errno
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calls import refused
from epiprior import ImageError, OutputError, RankedMatches, Status
from epiprior.geometry import sampson_distance
from epiprior.io import ColmapPair, write_colmap_database, write_matches
from epiprior.io.colmap import fundamental_for_colmap, homography_for_colmap
from epiprior.io.output import check_output, replacing
from epiprior.verification.degeneracy import homography_distance
from pictures import save, texture, turned_jpeg
from synthetic import make_estimate, make_matches, make_pair
from tables import read_table

OF_THE_SET = ("roll_deg", "rough_matrices", "image_sizes")
COLUMNS = [name for name in make_pair().matches.__dataclass_fields__ if name not in OF_THE_SET]


def two_sets():
    pair = make_pair(seed=5)
    rng = np.random.default_rng(0)
    ranges = {"similarity": (-1, 1), "two_keypoint_probability": (0, 1), "orientation2_deg": (0, 360)}
    columns = {name: rng.uniform(*limits, len(pair.matches)) for name, limits in ranges.items()}
    first = replace(pair.matches, supporting_matrices=rng.integers(0, 4950, len(pair.matches)), **columns)
    return first, replace(first.take(slice(0, 7)), roll_deg=37.25, probability=np.full(7, np.nan))


def assert_same(read, written, rtol):
    assert read.roll_deg == pytest.approx(written.roll_deg, rel=rtol)
    for name in COLUMNS:
        got, expected = getattr(read, name), getattr(written, name)
        assert (got.shape, got.dtype) == (expected.shape, expected.dtype)
        np.testing.assert_allclose(got, expected, rtol=rtol, err_msg=name)


@pytest.mark.parametrize(("suffix", "rtol"), [(".csv", 1e-8), (".npz", 0), (".CSV", 1e-8)])
def test_round_trip(tmp_path, suffix, rtol):
    written = two_sets()
    path = tmp_path / f"matches{suffix}"
    write_matches(path, written)
    read = read_table(path)
    assert len(read) == 2
    for got, expected in zip(read, written, strict=True):
        assert_same(got, expected, rtol)
    # Written again, the same bytes.
    before = path.read_bytes()
    write_matches(str(path), list(read))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    for nothing in (written[0].take(slice(0, 0)), ()):
        write_matches(path, nothing)
        assert read_table(path) == ()


def test_what_can_be_written_and_csv_for_people(tmp_path):
    first, second = two_sets()
    ranked = RankedMatches(sets=(first, second), standard=second, seconds={}, preset="default")
    write_matches(tmp_path / "ranked.csv", ranked)
    write_matches(tmp_path / "sets.csv", (first, second))
    write_matches(tmp_path / "one.csv", first)
    assert (tmp_path / "ranked.csv").read_bytes() == (tmp_path / "sets.csv").read_bytes()
    assert len(read_table(tmp_path / "one.csv")) == 1
    write_matches(tmp_path / "m.csv", make_matches([[1.5, 2.0]], [[3.0, 4.25]], np.array([np.nan])))
    header, row, end = (tmp_path / "m.csv").read_text().split("\n")
    cells = dict(zip(header.split(","), row.split(","), strict=True))
    assert end == ""
    assert (cells["x1"], cells["y1"], cells["x2"], cells["y2"]) == ("1.5", "2", "3", "4.25")
    assert cells["probability"] == ""
    assert set(COLUMNS) - {"x1", "x2"} <= set(cells)


@pytest.mark.parametrize("name", ["m.txt", "m", "missing/m.csv", "folder.csv: is a folder"])
def test_outputs_that_cannot_be(tmp_path, name):
    (tmp_path / "folder.csv").mkdir()
    refused(OutputError, name, write_matches, tmp_path / name.split(":")[0], two_sets())
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_full_disk_leaves_the_old_file(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"m{suffix}"
    path.write_text("old")

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text" if suffix == ".csv" else "open", full)
    refused(OutputError, rf"m\{suffix}: cannot be written: No space left", write_matches, path, two_sets())
    monkeypatch.undo()
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])


def test_a_write_that_is_not_allowed_is_told_before_the_work_and_one_cut_short_leaves_the_file(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(path) as partial:  # noqa: PT012
        partial.write_text("half")
        raise KeyboardInterrupt
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])
    monkeypatch.setattr("epiprior.io.output.os.access", lambda path, mode: False)
    refused(OutputError, f"no permission to write to the folder {tmp_path}", check_output, tmp_path / "m.csv")


PAIR = make_pair(seed=4, noise_px=0.2)


def test_fundamental_matrices_and_homographies_are_moved_to_the_pixels_of_colmap():
    pair = make_pair(seed=2)
    x1, x2 = pair.matches.x1, pair.matches.x2
    shifted = sampson_distance(fundamental_for_colmap(pair.F), x1 + 0.5, x2 + 0.5)
    np.testing.assert_allclose(shifted, sampson_distance(pair.F, x1, x2), rtol=1e-6, atol=1e-9)
    assert np.abs(sampson_distance(pair.F, x1 + 0.5, x2 + 0.5) - shifted).max() > 0.01
    H = np.array([[1.1, 0.1, 5.0], [-0.1, 0.9, 3.0], [1e-4, 2e-4, 1.0]])
    there, moved = (homography_distance(G, x1 + d, x2 + d) for G, d in ((H, 0.0), (homography_for_colmap(H), 0.5)))
    np.testing.assert_allclose(moved, there, rtol=1e-6)


@pytest.fixture
def images(tmp_path):
    (tmp_path / "images" / "sub").mkdir(parents=True)
    return [save(tmp_path / "images" / n, texture(1024, 768, i)) for i, n in enumerate(("a.png", "b.png", "sub/c.png"))]


def test_database_reads_back(tmp_path, images):
    pycolmap = pytest.importorskip("pycolmap")
    x1, x2 = PAIR.matches.x1, PAIR.matches.x2
    # The last match shares its keypoint of image 1 with the first inlier, which has to stay.
    x1 = np.vstack([x1, x1[np.flatnonzero(PAIR.right)[0]]])
    x2 = np.vstack([x2, [5.0, 5.0]])
    inliers = np.append(PAIR.right, False)
    found = make_estimate(PAIR, x1=x1, x2=x2, inliers=inliers)
    nothing = make_estimate(PAIR, Status.NO_MODEL, x1=x2, x2=x1, inliers=inliers & False)
    first = ColmapPair(image1=images[0], image2=images[2], estimate=found)
    second = ColmapPair(image1=images[1], image2=images[0], estimate=nothing)
    write_colmap_database(tmp_path / "out.db", [first, second])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["images", "out.db"]
    with pycolmap.Database.open(tmp_path / "out.db") as db:
        ids = {image.name: image.image_id for image in db.read_all_images()}
        assert set(ids) == {"a.png", "b.png", "sub/c.png"}
        a, b, c = (ids[name] for name in ("a.png", "b.png", "sub/c.png"))
        keypoints = {i: db.read_keypoints(i) for i in (a, b, c)}
        assert (len(keypoints[a]), len(keypoints[c])) == (len(x1) - 1, len(x1))
        geometry = db.read_two_view_geometry(a, c)
        got = geometry.inlier_matches
        assert len(got) == PAIR.right.sum()
        found = np.hstack([keypoints[a][got[:, 0]], keypoints[c][got[:, 1]]]) - 0.5
        np.testing.assert_allclose(found, np.hstack([x1, x2])[inliers], atol=1e-3)
        distance = sampson_distance(geometry.F, found[:, :2] + 0.5, found[:, 2:] + 0.5)
        np.testing.assert_allclose(distance, sampson_distance(PAIR.F, x1, x2)[inliers], atol=1e-3)
        matches = db.read_matches(a, c)
        assert len(matches) == len(x1) - 1
        assert len(np.unique(matches[:, 0])) == len(np.unique(matches[:, 1])) == len(matches)
        assert len(db.read_matches(b, a)) == len(x1) - 1
        assert not db.exists_two_view_geometry(a, b) or not len(db.read_two_view_geometry(a, b).inlier_matches)
        assert db.read_camera(db.read_image(a).camera_id).width == 1024


def test_databases_that_cannot_be(tmp_path, images):
    good = ColmapPair(image1=images[0], image2=images[1], estimate=make_estimate(PAIR))
    swapped = replace(good, image1=images[1], image2=images[0])
    path = tmp_path / "out.db"
    same, gone, turned = images[0], tmp_path / "gone.png", turned_jpeg(tmp_path / "turned.jpg")
    refused(OutputError, "paired with itself", write_colmap_database, path, [replace(good, image2=same)])
    refused(OutputError, "twice", write_colmap_database, path, [good, swapped])
    refused(OutputError, "no folder", write_colmap_database, tmp_path / "missing" / "out.db", [good])
    refused(ImageError, r"gone\.png", write_colmap_database, path, [replace(good, image2=gone)])
    refused(ImageError, r"turned\.jpg.*EXIF", write_colmap_database, path, [replace(good, image2=turned)])
    refused(ImageError, "outside", write_colmap_database, path, [good], image_root=tmp_path / "images" / "sub")
    assert not path.exists()
    path.write_text("precious")
    refused(OutputError, "exists already", write_colmap_database, path, [good])
    assert path.read_text() == "precious"


def test_without_disk_or_pycolmap_there_is_no_database(tmp_path, images, monkeypatch):
    pycolmap = pytest.importorskip("pycolmap")

    def full(*args):
        raise RuntimeError("SQLite error: database or disk is full")

    monkeypatch.setattr(pycolmap.Database, "write_keypoints", full)
    pair = ColmapPair(image1=images[0], image2=images[1], estimate=make_estimate(PAIR))
    refused(OutputError, r"out\.db.*disk is full", write_colmap_database, tmp_path / "out.db", [pair])
    assert [p.name for p in tmp_path.iterdir()] == ["images"]
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    refused(OutputError, "pip install 'pycolmap", write_colmap_database, tmp_path / "out.db", [])
