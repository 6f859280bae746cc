"""A collection from images to matched pairs: what is kept, what is used again, what a kill leaves."""

import contextlib
import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

import epiprior
from calls import note_calls
from collections_fakes import MATCHES, FakeEstimation, in_this_process, rows_of, small_images, views
from epiprior import EstimatorError, OutputError, SettingsError, Status, match_collection
from epiprior.collection import match
from epiprior.collection.features import make_features, read_features
from epiprior.collection.images import find_images
from epiprior.collection.store import MatchedPair, PairStore
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.geometry import sampson_distance
from epiprior.presets import DEFAULT
from epiprior.verification.cascade import CascadeRule
from pictures import relief_pair, rotated, save

pycolmap = pytest.importorskip("pycolmap")


def test_matches_are_rows_of_keypoints_one_to_one(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    small_images(tmp_path / "set")
    seen, steps = [], []
    found = match_collection(tmp_path / "set", on_pair=seen.append, on_progress=lambda *step: steps.append(step))
    assert [pair.image1[0] + pair.image2[0] for pair in found] == ["ab", "ac", "bc"]
    assert steps == [*(("features", n, 3) for n in (1, 2, 3)), *(("pairs", n, 3) for n in (1, 2, 3))]
    assert [pair.image2 for pair in seen] == [pair.image2 for pair in found]
    rows = {}
    for pair in found:
        assert (pair.geometry, pair.confidence, len(pair.matches)) == ("UNCALIBRATED", 1.0, MATCHES)
        for name, column in ((pair.image1, 0), (pair.image2, 1)):
            assert len(np.unique(pair.matches[:, column])) == MATCHES
            rows.setdefault(name, []).append(np.sort(pair.matches[:, column]))
    for place, image in enumerate(found.images.images):
        # The same places are the same rows in all pairs, and the first of their twins.
        first, second = rows[image.name]
        np.testing.assert_array_equal(first, second)
        xy = found.features(place).xy
        np.testing.assert_array_equal(np.unique(xy, axis=0)[:MATCHES], xy[first][np.lexsort(xy[first].T[::-1])])
        assert all((xy[:row] != xy[row]).any(axis=1).all() for row in first)


def test_simple_matches_of_an_f_are_joined_by_those_along_its_lines(tmp_path):
    found = match_collection(views(tmp_path / "set", 2), mode="standard", workers=1)
    (pair,) = found
    assert 0 < pair.guided < len(pair.matches)
    x1, x2 = (found.features(place).xy[rows].astype(float) for place, rows in enumerate(pair.matches.T))
    assert sampson_distance(pair.F, x1, x2).max() < 2.0
    assert all(len(np.unique(rows)) == len(rows) for rows in pair.matches.T)


def test_a_camera_that_stands_still_is_no_watermark(tmp_path, monkeypatch):
    """A sequence would be cut where it stands: COLMAP's mapper passes over watermarks."""
    still, moved = tmp_path / "set", views(tmp_path / "moved", 1)
    still.mkdir()
    pixels = cv2.imread(str(moved / "0.png"), cv2.IMREAD_GRAYSCALE)
    save(still / "0.png", pixels)
    save(
        still / "1.png", np.clip(pixels + np.random.default_rng(1).normal(0, 3, pixels.shape), 0, 255).astype(np.uint8)
    )
    (pair,) = match_collection(still, workers=1)
    assert (pair.status, pair.geometry) == ("degenerate", "PANORAMIC")
    monkeypatch.setattr(match, "_COPY_SHARE", 0.99)  # as if few of the features agreed
    images, files = find_images(still).images, (tmp_path / "0", tmp_path / "1")
    for file, image in zip(files, images, strict=True):
        file.write_bytes(make_features(image, DEFAULT.features))
    _, found = match.match_pair(images, files, match.MatchSettings(settings=DEFAULT))
    assert found.geometry == "WATERMARK"


def test_the_largest_features_are_tried_first(tmp_path, monkeypatch):
    images = find_images(views(tmp_path / "set", 2)).images
    files = tmp_path / "1", tmp_path / "2"
    for file, image in zip(files, images, strict=True):
        file.write_bytes(make_features(image, DEFAULT.features))
    for module in ("epiprior.collection.match", "epiprior.two_view"):
        monkeypatch.setattr(f"{module}.load_cascade_rule", lambda: CascadeRule(min_confidence=0.8))
    counts, scales = [], [read_features(file).features.scale for file in files]

    def matched(largest):
        monkeypatch.setattr(match, "LARGEST", largest)
        pair, _ = match.match_pair(tuple(images), files, match.MatchSettings(settings=DEFAULT))
        counts.append(len(pair.matches))
        return pair

    few = matched(len(scales[0]) // 2)
    kept = few.matches[: len(few.matches) - few.guided]
    assert 20 < len(kept) < few.guided
    assert all((scale[rows] >= np.median(scale)).all() for scale, rows in zip(scales, kept.T, strict=True))
    whole, again = matched(100_000), matched(20)  # of so few no F is kept
    np.testing.assert_array_equal(whole.matches, again.matches)
    assert whole.guided < few.guided
    assert counts[0] > 0.9 * counts[1]


def test_what_is_ready_is_not_made_again(tmp_path, monkeypatch):
    first = in_this_process(monkeypatch)
    small_images(tmp_path / "set")
    before = list(match_collection(tmp_path / "set", work=tmp_path / "work", pairs="sequential:1"))
    assert len(first.calls) == 2
    again = in_this_process(monkeypatch)
    monkeypatch.setattr("epiprior.collection.run.make_features", None)
    found = match_collection(tmp_path / "set", work=tmp_path / "work", without={("a.png", "b.png")})
    assert len(again.calls) == 1
    assert [(pair.image1, pair.image2) for pair in found] == [("a.png", "c.png"), ("b.png", "c.png")]
    np.testing.assert_array_equal(list(found)[1].matches, before[1].matches)
    np.testing.assert_array_equal(list(found)[1].F, before[1].F)
    match_collection(tmp_path / "set", work=tmp_path / "work", seed=1)
    assert len(again.calls) == 4


def test_pairs_are_read_as_they_were_kept_and_those_of_another_version_are_forgotten(tmp_path):
    with contextlib.closing(sqlite3.connect(tmp_path / "pairs.db", isolation_level=None)) as old:
        old.execute("CREATE TABLE pairs (key, image1, PRIMARY KEY (key)) WITHOUT ROWID")
        old.execute("INSERT INTO pairs VALUES (?, 'a')", (b"k",))
    M, rows = np.arange(9.0).reshape(3, 3), np.array([[1, 2], [3, 4]])
    known = {"geometry": "CALIBRATED", "confidence": 0.9, "guided": 1, "input": "snn", "seconds": 0.5}
    pair = MatchedPair(image1="a", image2="b", status="ok", F=M, E=2 * M, matches=rows, **known)
    with contextlib.closing(PairStore(tmp_path / "pairs.db")) as store:
        assert b"k" not in store
        store.write(b"k", pair)
    store = PairStore(tmp_path / "pairs.db")
    for name, value in vars(store.read(b"k")).items():
        np.testing.assert_array_equal(value, getattr(pair, name))
    with ThreadPoolExecutor(1) as other:  # as garbage collection in any thread does
        other.submit(store.close).result()


def test_pairs_are_kept_without_and_under_their_cameras(tmp_path, monkeypatch):
    estimation = in_this_process(monkeypatch)
    small_images(tmp_path / "set")
    how = {"work": tmp_path / "work", "pairs": "sequential:1"}
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 300, 200, 150)
    camera.has_prior_focal_length = True
    known = match_collection(tmp_path / "set", **how, cameras={"a.png": camera, "b.png": camera})
    assert [call["intrinsics"] is not None for call in estimation.calls] == [True, False]
    assert [pair.F is not None for pair in known.plain] == [True, True]
    match_collection(tmp_path / "set", **how)
    assert len(estimation.calls) == 2
    other = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 900, 200, 150)
    other.has_prior_focal_length = True
    keys = {known.key((0, 1)), known.plain.key((0, 1))}
    keys.add(match_collection(tmp_path / "set", **how, cameras={"a.png": camera, "b.png": other}).key((0, 1)))
    assert len(keys) == 3
    assert len(estimation.calls) == 3


def test_pairs_without_geometry_have_no_matches(tmp_path, monkeypatch):
    in_this_process(monkeypatch, FakeEstimation(Status.DEGENERATE))
    small_images(tmp_path)
    for pair in match_collection(tmp_path):
        assert (pair.status, pair.message, pair.geometry) == ("degenerate", "as the test wants", "")
        assert (pair.F, pair.matches.shape) == (None, (0, 2))


def test_similar_images_are_known_after_their_features(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    files = small_images(tmp_path, tuple("abcd"[k] + ".png" for k in range(4)))
    for near, file in ((3, files[0]), (2, files[1])):
        (tmp_path / f"{'abcd'[near]}.png").unlink()
        save(files[near], np.ascontiguousarray(epiprior.features.images.read_image(file, 0)[5:, 5:]))
    assert match_collection(tmp_path, pairs="similar:1").pairs == [(0, 3), (1, 2)]


def test_what_cannot_be_is_told_before_the_work(tmp_path, monkeypatch):
    estimation = in_this_process(monkeypatch)
    small_images(tmp_path / "set")
    (tmp_path / "file").write_text("")
    for error, words, options in (
        (EstimatorError, "nonsense", {"estimator": "nonsense"}),
        (SettingsError, "preset is 'x'", {"preset": "x"}),
        (SettingsError, "mode is 'x'", {"mode": "x"}),
        (SettingsError, "pairs = 'x'", {"pairs": "x"}),
        (OutputError, "file", {"work": tmp_path / "file"}),
    ):
        with pytest.raises(error, match=words):
            match_collection(tmp_path / "set", **{"work": tmp_path / "work", **options})
    assert estimation.calls == []
    assert not (tmp_path / "work").exists()


def test_stored_features_give_the_same_as_photographs(tmp_path, monkeypatch):
    """Also under a second roll hypothesis, for which the photograph is decoded."""
    left, right = relief_pair(240, 180, 3)
    save(tmp_path / "a.png", left)
    save(tmp_path / "b.png", rotated(right, 40.0)[0])
    direct = [load_photograph(tmp_path / name) for name in ("a.png", "b.png")]
    features = [detect_features(photograph, DEFAULT.features) for photograph in direct]
    expected = epiprior.rank_matches(*direct)
    views = []
    for image, own in zip(find_images(tmp_path).images, features, strict=True):
        file = tmp_path / f"{image.name}.npz"
        file.write_bytes(make_features(image, DEFAULT.features))
        stored = read_features(file)
        np.testing.assert_array_equal(stored.features.descriptors, own.descriptors)
        views.append(stored.view(image, DEFAULT.features))
        assert not views[-1].grey.any()
    decoded = note_calls(monkeypatch, epiprior.collection.features, "_load")
    found = epiprior.rank_matches(*views, features1=features[0], features2=features[1])
    assert len(found.sets) == len(expected.sets) == 2
    for mine, other in zip(found.sets, expected.sets, strict=True):
        np.testing.assert_array_equal(mine.probability, other.probability)
    assert len(decoded) == 1  # the second in our order, which is not that of the names


PROGRAM = """
import sys, epiprior
found = epiprior.match_collection(sys.argv[1], work=sys.argv[2], workers=2, mode="standard")
"""


def kept_rows(path):
    """All that is kept, without how long it took."""
    return [row[:-1] for row in rows_of(path, "pairs")["pairs"]]


def begun(path):
    with contextlib.suppress(sqlite3.OperationalError):
        return path.is_file() and bool(rows_of(path, "pairs")["pairs"])


@pytest.mark.slow
def test_a_killed_run_goes_on(tmp_path):
    folder, kept = views(tmp_path / "set", 4), tmp_path / "work" / "pairs.db"
    match_collection(folder, work=tmp_path / "whole", workers=1, mode="standard")
    whole = kept_rows(tmp_path / "whole" / "pairs.db")
    assert len(whole) == 6
    assert sum("UNCALIBRATED" in row for row in whole) > 3
    with subprocess.Popen([sys.executable, "-c", PROGRAM, str(folder), str(kept.parent)]) as running:
        while running.poll() is None and not begun(kept):
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
    assert begun(kept)
    match_collection(folder, work=kept.parent, workers=1, mode="standard")
    assert kept_rows(kept) == whole


@pytest.mark.slow
def test_a_cluster_gives_the_same(tmp_path):
    distributed = pytest.importorskip("distributed")
    views(tmp_path / "set", 3)
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0"}
    match_collection(tmp_path / "set", work=tmp_path / "here", workers=1, mode="standard")
    with distributed.LocalCluster(**options) as cluster:
        address = cluster.scheduler_address
        match_collection(tmp_path / "set", work=tmp_path / "there", scheduler=address, mode="standard")
    assert kept_rows(tmp_path / "there" / "pairs.db") == kept_rows(tmp_path / "here" / "pairs.db")
