"""Tables of matches: what is written is read back; what cannot be written says why. Pixels of COLMAP."""

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calls import refused
from epiprior import OutputError, RankedMatches
from epiprior.geometry import sampson_distance
from epiprior.io import write_matches
from epiprior.io.colmap import fundamental_for_colmap, homography_for_colmap
from epiprior.io.output import check_output, replacing
from epiprior.verification.degeneracy import homography_distance
from synthetic import make_matches, make_pair
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


def test_fundamental_matrices_and_homographies_are_moved_to_the_pixels_of_colmap():
    pair = make_pair(seed=2)
    x1, x2 = pair.matches.x1, pair.matches.x2
    shifted = sampson_distance(fundamental_for_colmap(pair.F), x1 + 0.5, x2 + 0.5)
    np.testing.assert_allclose(shifted, sampson_distance(pair.F, x1, x2), rtol=1e-6, atol=1e-9)
    assert np.abs(sampson_distance(pair.F, x1 + 0.5, x2 + 0.5) - shifted).max() > 0.01
    H = np.array([[1.1, 0.1, 5.0], [-0.1, 0.9, 3.0], [1e-4, 2e-4, 1.0]])
    there, moved = (homography_distance(G, x1 + d, x2 + d) for G, d in ((H, 0.0), (homography_for_colmap(H), 0.5)))
    np.testing.assert_allclose(moved, there, rtol=1e-6)
