"""From a database to a model: what becomes of focal lengths that are known, nearly known, or have drifted."""

import contextlib
import itertools
from dataclasses import replace

import numpy as np
import pytest

from epiprior.collection import model
from epiprior.collection.model import map_beside, map_database, map_once
from epiprior.collection.workers import WorkerLostError
from epiprior.io.colmap import add_camera, add_image, add_pair
from synthetic import rotation, skew

pycolmap = pytest.importorskip("pycolmap")
TRUE, GUESS = 1280.0, 1400.0


@pytest.fixture
def database(tmp_path):
    """Five photographs of 1024 x 768 pixels by cameras of the focal length TRUE, which the database does not know."""
    rng, K = np.random.default_rng(0), np.array([[TRUE, 0.0, 511.5], [0.0, TRUE, 383.5], [0.0, 0.0, 1.0]])
    X = rng.uniform((-2, -1.5, 8), (2, 1.5, 13), (150, 3))
    # No two of the axes meet: those that do tell nothing of the focal length.
    poses = [(rotation(rng.normal(size=3), 7.0), np.array([0.8 * k - 1.6, *rng.normal(0, 0.5, 2)])) for k in range(5)]
    rows, inverse = np.column_stack([np.arange(150)] * 2), np.linalg.inv(K)
    with pycolmap.Database.open(tmp_path / "a.db") as opened:
        ids = []
        for k, (R, t) in enumerate(poses):
            camera = pycolmap.Camera.create_from_model_name(0, "SIMPLE_RADIAL", GUESS, 1024, 768)
            seen = (X @ R.T + t) @ K.T
            ids.append(add_image(opened, f"{k}.jpg", add_camera(opened, camera), seen[:, :2] / seen[:, 2:]))
        for a, b in itertools.combinations(range(5), 2):
            R = poses[b][0] @ poses[a][0].T
            F = inverse.T @ skew(poses[b][1] - R @ poses[a][1]) @ R @ inverse
            add_pair(opened, (ids[a], ids[b]), rows, inliers=150, configuration="UNCALIBRATED", F=F)
    return tmp_path / "a.db"


def focal_lengths(folder):
    return sorted(camera.focal_length for camera in pycolmap.Reconstruction(folder).cameras.values())


def know_focal_lengths(database, numbers):
    with pycolmap.Database.open(database) as opened:
        for number in numbers:
            camera = opened.read_camera(number)
            camera.has_prior_focal_length = True
            opened.update_camera(camera)


@pytest.mark.parametrize(("refine", "images", "stay"), [(False, 4, True), (True, 6, True), (True, 4, False)])
def test_known_focal_lengths_are_refined_last_or_never(database, tmp_path, monkeypatch, refine, images, stay):
    know_focal_lengths(database, range(1, 6))
    monkeypatch.setattr(model, "_LEAST_IMAGES", images)
    (found,) = map_database(database, tmp_path, tmp_path / "out", refine=refine)
    assert len(found.seen) == 5
    assert found.folder == tmp_path / "out" / "0"
    if stay:
        assert focal_lengths(found.folder) == [GUESS] * 5
    else:
        np.testing.assert_allclose(focal_lengths(found.folder), TRUE, rtol=1e-3)
        assert found.error_px < 0.01
    assert (found.folder / "points.ply").is_file()


def test_known_focal_lengths_stay_where_others_are_refined(database, tmp_path):
    know_focal_lengths(database, [2])
    (found,) = map_database(database, tmp_path, tmp_path / "out")
    lengths = {number: camera.focal_length for number, camera in pycolmap.Reconstruction(found.folder).cameras.items()}
    assert lengths.pop(2) == GUESS
    assert GUESS not in lengths.values()


@pytest.mark.parametrize("better", [True, False])
@pytest.mark.parametrize("map_it", [map_database, map_beside])
def test_what_has_drifted_is_mapped_again_by_what_pairs_tell(database, tmp_path, monkeypatch, better, map_it):
    know_focal_lengths(database, [2])
    limits = (GUESS / 1024 + 0.01, 5.0) if not better else (0.3, 5.0)
    (first,) = map_once(database, tmp_path, tmp_path / "out", 0, True)
    assert not first.drifted
    models = [replace(first, drifted=True)]
    monkeypatch.setattr(model, "_FOCAL_RATIOS", limits)
    monkeypatch.setattr(model, "map_once", lambda *_: models)
    monkeypatch.setattr(model, "open_pool", contextlib.nullcontext)
    monkeypatch.setattr(model, "run_tasks", lambda _, function, jobs: [(key, function(*args)) for key, args in jobs])
    seed = {"seed": 0} if map_it is map_database else {}
    found = map_it(database, tmp_path, tmp_path / "out", *([] if seed else [0]), **seed)
    assert found[0].drifted != better
    assert [path.name for path in found[0].folder.parent.iterdir()] == ["0"]
    assert found[0].folder == tmp_path / "out" / "0"
    if better:
        # That one is known wrongly is adjusted at the end, with the others.
        np.testing.assert_allclose(focal_lengths(found[0].folder), TRUE, rtol=1e-3)
    assert {camera.focal_length for camera in model._cameras(database).values()} == {GUESS}


def test_a_failed_second_mapping_costs_nothing(database, tmp_path, monkeypatch, caplog):
    (first,) = map_once(database, tmp_path, tmp_path / "out", 0, True)
    answers = iter([[(0, [replace(first, drifted=True)])], WorkerLostError("as the test wants")])

    def answer(*_):
        one = next(answers)
        if isinstance(one, Exception):
            raise one
        return one

    monkeypatch.setattr(model, "run_tasks", answer)
    (found,) = map_beside(database, tmp_path, tmp_path / "out", 0)
    assert found.folder == first.folder
    assert "as the test wants" in caplog.text


@pytest.mark.parametrize(
    ("ratio", "count", "drifted"), [(0.2, 1, True), (4.0, 5, False), (6.0, 1, True), (6.0, 0, False)]
)
def test_focal_lengths_beyond_those_of_lenses_have_drifted(database, tmp_path, ratio, count, drifted):
    (found,) = map_database(database, tmp_path, tmp_path / "out")
    reconstruction = pycolmap.Reconstruction(found.folder)
    for number in range(1, 1 + count):
        reconstruction.cameras[number].params = [ratio * 1024, 512.0, 384.0, 0.0]
    assert model._has_drifted(reconstruction, set(range(1, 6))) == drifted
    assert not model._has_drifted(reconstruction, set())


def test_the_median_of_pairs_stands_in_for_what_is_not_known(database, tmp_path, monkeypatch):
    know_focal_lengths(database, [1])
    assert model.copy_with_median(database, tmp_path / "b.db", 0) == {2, 3, 4, 5}
    found = {number: camera.focal_length for number, camera in model._cameras(tmp_path / "b.db").items()}
    assert found.pop(1) == GUESS
    assert len(set(found.values())) == 1
    np.testing.assert_allclose(found[2], TRUE, rtol=0.02)
    monkeypatch.setattr(model, "_FOCAL_RATIOS", (2.0, 5.0))
    assert not model.copy_with_median(database, tmp_path / "c.db", 0)
    monkeypatch.setattr(pycolmap, "calibrate_view_graph", lambda *_: False)
    assert not model.copy_with_median(database, tmp_path / "d.db", 0)
