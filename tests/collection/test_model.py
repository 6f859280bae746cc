"""From a database to a model: what becomes of focal lengths that are known, nearly known, or have drifted."""

import itertools

import numpy as np
import pycolmap
import pytest

from epiprior.collection import model
from epiprior.collection.model import map_database
from epiprior.io.colmap import add_camera, add_image, add_pair
from synthetic import rotation, skew

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


@pytest.mark.parametrize(("refine", "images", "stay"), [("never", 4, True), ("last", 6, True), ("last", 4, False)])
def test_known_focal_lengths_are_refined_last_or_never(database, tmp_path, monkeypatch, refine, images, stay):
    monkeypatch.setattr(model, "_DETERMINED", images)
    (found,) = map_database(database, tmp_path, tmp_path / "out", refine=refine)
    assert len(found.seen) == 5
    assert found.folder == tmp_path / "out" / "0"
    if stay:
        assert focal_lengths(found.folder) == [GUESS] * 5
    else:
        np.testing.assert_allclose(focal_lengths(found.folder), TRUE, rtol=1e-3)
    assert (found.folder / "points.ply").is_file()


@pytest.mark.parametrize("drifts", [[True, False, False], [True, True, True], [False]])
def test_what_has_drifted_is_mapped_again_by_what_pairs_tell(database, tmp_path, monkeypatch, drifts):
    told, outcomes, models = iter(drifts), [], []

    def mapped(database, image_root, out, seed, refine):
        outcomes.append((refine, sorted(c.focal_length for c in model._cameras(database).values())))
        models.append(run(database, image_root, out, seed, refine))
        return models[-1]

    run = model._map
    monkeypatch.setattr(model, "_map", mapped)
    monkeypatch.setattr(model, "_has_drifted", lambda _: next(told))
    (found,) = map_database(database, tmp_path, tmp_path / "out")
    assert [refine for refine, _ in outcomes] == ["always", "last"][: 1 + (len(drifts) > 1)]
    assert outcomes[0][1] == [GUESS] * 5
    if len(drifts) > 1:
        np.testing.assert_allclose(outcomes[1][1], TRUE, rtol=0.02)
        assert len(set(outcomes[1][1])) == 1  # the median of all
    kept = models[1 if drifts == [True, False, False] else 0][0]
    assert focal_lengths(found.folder) == sorted(camera.focal_length for camera in kept.cameras.values())
    assert [path.name for path in found.folder.parent.iterdir()] == ["0"]
    assert [camera.focal_length for camera in model._cameras(database).values()] == [GUESS] * 5


def test_a_focal_length_that_no_lens_has_has_drifted(database, tmp_path):
    (found,) = map_database(database, tmp_path, tmp_path / "out")
    reconstruction = pycolmap.Reconstruction(found.folder)
    assert not model._has_drifted(reconstruction)
    for ratio, drifted in ((0.2, True), (4.0, False), (6.0, True)):
        reconstruction.cameras[1].params = [ratio * 1024, 512.0, 384.0, 0.0]
        assert model._has_drifted(reconstruction) == drifted


def test_known_focal_lengths_stay_where_others_are_told(database, tmp_path, monkeypatch):
    with pycolmap.Database.open(database) as opened:
        camera = opened.read_camera(1)
        camera.has_prior_focal_length = True
        opened.update_camera(camera)
    assert model._with_focal_lengths(database, tmp_path / "b.db", 0)
    assert model._cameras(tmp_path / "b.db")[1].focal_length == GUESS
    monkeypatch.setattr(pycolmap, "calibrate_view_graph", lambda *_: False)
    assert not model._with_focal_lengths(database, tmp_path / "c.db", 0)
