"""Importers that work on structure from motion: COLMAP models, Strecha's cameras, one's own photographs."""

import itertools
import logging
import os
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from epiprior.errors import ImageError, SettingsError
from epiprior.geometry import sampson_distance
from epiprior_lab.pairsets import Camera, DatasetError, fundamental_from_cameras, read_pair_set, reproject
from epiprior_lab.pairsets.importers.colmap import find_colmap
from epiprior_lab.pairsets.importers.output import write_found
from epiprior_lab.pairsets.importers.photos import find_photos
from epiprior_lab.pairsets.importers.strecha import find_strecha, read_camera
from epiprior_lab.pairsets.importers.structure import PairChoice
from epiprior_lab.scenes.pairs import look_at
from epiprior_lab.scenes.render import render_image
from epiprior_lab.scenes.world import Frame, WorldBuilder, box
from pictures import save, texture
from worlds import OVERCAST_FROM_ASIDE, coloured

EVERY, MOST = (PairChoice(min_angle_deg=low, max_angle_deg=180 - low) for low in (1, 5))


def refused(find, folder, message, error=DatasetError, **options):
    with pytest.raises(error, match=message):
        find(folder, **options)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """Return a workspace with an exact model of six distorted photographs."""
    root = tmp_path_factory.mktemp("colmap") / "yard"
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 6, 150
    options.camera_width, options.camera_height = 320, 240
    options.camera_params = [400.0, 160.0, 120.0, 0.05]
    model = pycolmap.synthesize_dataset(options)
    (root / "sparse/0").mkdir(parents=True)
    (root / "images").mkdir()
    model.write_binary(root / "sparse/0")
    for number, image in enumerate(model.images.values()):
        save(root / "images" / image.name, texture(320, 240, number))
    return root


@pytest.fixture
def model(workspace, tmp_path):
    for kind in ("binary", "text"):
        (tmp_path / kind).mkdir()
        getattr(pycolmap.Reconstruction(workspace / "sparse/0"), f"write_{kind}")(tmp_path / kind)
    return tmp_path


def test_colmap_cameras_and_pixels_are_undistorted_and_count_from_zero(workspace, tmp_path):
    write_found(tmp_path / "set", find_colmap(workspace, choice=MOST))
    pairs = read_pair_set(tmp_path / "set").pairs
    assert len(pairs) >= 6
    model = pycolmap.Reconstruction(workspace / "sparse/0")
    images = {image.name.removesuffix(".png"): image for image in model.images.values()}
    pair = pairs[0]
    assert (pair.scene, pair.truth) == ("yard", "epipolar")
    x1, x2 = pair.control_points()
    assert len(x1) >= 12
    assert sampson_distance(pair.fundamental(), x1, x2).max() < 1e-3
    # Where the model sees its points, after distortion and half a pixel, is where ours says.
    for image_path, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2)):
        image = images[image_path.stem]
        seen = [point for point in image.points2D if point.has_point3D()]
        ours, _ = camera.project(np.array([model.points3D[point.point3D_id].xyz for point in seen]))
        rays = image.camera.cam_from_img(np.array([point.xy for point in seen]))
        np.testing.assert_allclose(ours, (np.column_stack([rays, np.ones(len(rays))]) @ camera.K.T)[:, :2], atol=1e-3)
        assert abs(camera.K[0, 2] - (camera.width / 2 - 0.5)) < 1e-6
        assert cv2.imread(str(image_path)).shape[:2] == (camera.height, camera.width)
    # A line of the world, bent in the photograph, is straight afterwards, where the camera says.
    image = min(model.images.values(), key=lambda image: image.name)
    pixels = np.zeros((240, 320, 3), np.uint8)
    y, x = np.mgrid[:240, :320]
    rays = image.camera.cam_from_img(np.column_stack([x.ravel() + 0.5, y.ravel() + 0.5]))
    pixels[(np.abs(rays[:, 1] + 0.24) < 0.008).reshape(240, 320)] = 255
    (tmp_path / "images").mkdir()
    for other in model.images.values():
        cv2.imwrite(str(tmp_path / "images" / other.name), pixels)
    photograph = find_colmap(workspace / "sparse/0", images=tmp_path / "images", choice=EVERY)[0].image1
    plain = photograph.develop()[:, :, 0].astype(float)
    middle = (plain * np.arange(plain.shape[0])[:, None]).sum(axis=0)[5:-5] / plain.sum(axis=0)[5:-5]
    np.testing.assert_allclose(middle, photograph.camera.K[1, 1] * -0.24 + photograph.camera.K[1, 2], atol=0.4)


def angles_of(found):
    return [float(pair.difficulty.split("deg")[0].removeprefix("angle=")) for pair in found]


def test_a_model_of_text_is_the_same_and_pairs_are_those_that_are_asked_for(workspace, model):
    every = find_colmap(workspace, choice=EVERY)
    angles = angles_of(every)
    assert len(every) == 15
    low, high = np.quantile(angles, [0.2, 0.8])
    some = find_colmap(workspace, choice=PairChoice(min_angle_deg=low, max_angle_deg=high))
    wanted = {pair.pair_id for pair, angle in zip(every, angles, strict=True) if low <= angle <= high}
    assert {pair.pair_id for pair in some} == wanted
    kept = angles_of(find_colmap(workspace, choice=replace(EVERY, max_pairs=3)))
    assert (min(kept), max(kept), len(kept)) == (min(angles), max(angles), 3)
    with pytest.raises(DatasetError, match="no pair with PairChoice"):
        find_colmap(workspace, choice=PairChoice(min_shared=1000))
    for wrong in ({"min_angle_deg": 80}, {"max_pairs": 0}, {"min_shared": 3}):
        with pytest.raises(SettingsError):
            PairChoice(**wrong)
    ours = find_colmap(workspace, choice=MOST)
    text = find_colmap(model / "text", images=workspace / "images", choice=MOST)
    assert [pair.pair_id for pair in ours] == [pair.pair_id for pair in text]
    np.testing.assert_allclose(ours[0].points[0], text[0].points[0], atol=1e-6)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_damage_of_a_model_is_named(workspace, model, name):
    path, own = model / "binary" / f"{name}.bin", {"images": workspace / "images"}
    content = path.read_bytes()
    for length in (5, len(content) // 2, -3):
        path.write_bytes(content[:length])
        refused(find_colmap, model / "binary", rf"{name}\.bin: damaged", **own)
    path = model / "text" / f"{name}.txt"
    rows = path.read_text().splitlines()
    first = next(index for index, row in enumerate(rows) if not row.startswith("#"))
    values = rows[first].split()
    for row in (" ".join([*values[:3], "wide", *values[4:]]), "1 2"):
        path.write_text("\n".join([*rows[:first], row, *rows[first + 1 :]]) + "\n")
        refused(find_colmap, model / "text", "text: damaged COLMAP model", **own)


def test_what_is_missing_and_names_that_a_colmap_model_cannot_hold_are_named(workspace, tmp_path, model):
    for folder, message in ((tmp_path, "no COLMAP model"), (workspace, r"no image .*camera000001")):
        with pytest.raises(DatasetError, match=message):
            find_colmap(folder, images=tmp_path)
    for path in (workspace / "images").iterdir():
        save(tmp_path / path.name, texture(100, 80))
    with pytest.raises(DatasetError, match=r"is 100 x 80, its camera in the model 320 x 240"):
        write_found(tmp_path / "set", find_colmap(workspace, images=tmp_path, choice=EVERY))
    for file, new, message in (
        ("text/images.txt", b"Photo 1 of 4", "no image .*Photo, which the model names"),
        ("binary/images.bin", b"caf\xe9ra000001_frame000001", r"images\.bin: image \d: .* no name that is not UTF-8"),
    ):
        path = model / file
        path.write_bytes(path.read_bytes().replace(b"camera000001_frame000001", new))
        with pytest.raises(DatasetError, match=message):
            find_colmap(path.parent, images=workspace / "images")


def scene_cameras():
    turns = enumerate(np.radians([-18, -6, 6, 18]))
    eyes = [np.array([7 * np.sin(a), -1.0 - 0.4 * (k % 2), -7 * np.cos(a)]) for k, a in turns]
    return [look_at(eye, np.array([0, 0.2, -1.0]), roll_deg=0.0, focal_px=280.0, width=320, height=240) for eye in eyes]


def photograph_name(number):
    """Return a name that is neither free of blanks nor UTF-8."""
    return os.fsdecode(b"Photo 1 of 4, caf\xe9 %d" % number)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Return a folder of four views of a crate in a corner."""
    folder = tmp_path_factory.mktemp("photos") / "crate"
    folder.mkdir()
    builder = WorldBuilder(surroundings=np.full((64, 128, 3), 200, np.uint8))
    wall, floor, crate = (builder.texture(coloured(seed)) for seed in (0, 10, 20))
    builder.face((-4.0, -4.0, 0.0), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0), wall)
    builder.face((-4.0, 2.0, 0.0), (8.0, 0.0, 0.0), (0.0, 0.0, -6.0), floor)
    box(builder, Frame.facing((-1.5, 2.0, -2.0), 0.0), (0.0, 3.0), (0.0, 2.5), (-1.5, 0.0), textures=crate)
    world = builder.build()
    for number, camera in enumerate(scene_cameras()):
        save(folder / "v.png", render_image(world, camera, OVERCAST_FROM_ASIDE))
        (folder / "v.png").rename(folder / f"{photograph_name(number)}.png")
    return folder


def assert_epipolar(pair, cameras, tolerance):
    """Check the F of a pair against points of the world, seen through the cameras that rendered it."""
    camera1, camera2 = (cameras[int(path.stem[-1])] for path in (pair.image1, pair.image2))
    x1 = np.random.default_rng(0).uniform((20, 20), (300, 220), (60, 2))
    x2, _ = reproject(camera1, camera2, x1, np.random.default_rng(1).uniform(4, 8, 60))
    assert np.median(sampson_distance(pair.fundamental(), x1, x2)) < tolerance


@pytest.mark.slow
def test_photographs_become_pairs_with_cameras(photographs, tmp_path, caplog):
    save(photographs / "stray.png", np.full((240, 320), 90, np.uint8))
    with caplog.at_level(logging.WARNING):
        found = find_photos(photographs)
    assert "1 photographs fit nowhere: stray.png" in caplog.text
    (photographs / "stray.png").unlink()
    write_found(tmp_path / "set", found)
    pairs = read_pair_set(tmp_path / "set").pairs
    names = [f"Photo 1 of 4, café {number}" for number in range(4)]
    assert [pair.pair_id for pair in pairs] == [f"{a}_{b}" for a, b in itertools.combinations(names, 2)]
    for pair in pairs:
        assert pair.scene == "crate"
        assert_epipolar(pair, scene_cameras(), 0.5)
        assert sampson_distance(pair.fundamental(), *pair.control_points()).max() < 1e-4
    # A second run gives the same bytes.
    write_found(tmp_path / "again", find_photos(photographs))
    for path in sorted((tmp_path / "set").rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "set")).read_bytes(), path


def test_photographs_are_checked_before_any_work(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("epiprior_lab.pairsets.importers.photos._match", lambda _: pytest.fail("work began"))
    for name in ("._a.jpg", "._b.jpg"):
        (tmp_path / name).write_bytes(b"attributes")
    refused(find_photos, tmp_path, "0 photographs, expected 3 or more")
    assert caplog.messages == [f"{tmp_path}: 2 files ._* skipped: attributes that macOS keeps"]
    for name in ("a.jpg", "b.jpg", "b.png"):
        save(tmp_path / name, texture(64, 64))
    refused(find_photos, tmp_path, r"b\.jpg and .*b\.png would both become images/b")
    broken = (tmp_path / "b.png").rename(tmp_path / "c.png")
    broken.write_bytes(broken.read_bytes()[:60])
    refused(find_photos, tmp_path, r"c\.png: not an image", ImageError)


def camera_text(camera: Camera) -> str:
    rows = [*camera.K, np.zeros(3), *camera.R.T, camera.centre, np.array([camera.width, camera.height])]
    return "".join(" ".join(f"{value:.12g}" for value in row) + " \n" for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize(("images", "cameras"), [("", ""), ("images", "gt_dense_cameras")])
def test_strecha(photographs, tmp_path, images, cameras):
    folder = tmp_path / "fountain"
    for part in (images, cameras):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for number, camera in enumerate(scene_cameras()):
        name = f"{photograph_name(number)}.png"
        (folder / images / name).write_bytes((photographs / name).read_bytes())
        (folder / cameras / f"{name}.camera").write_text(camera_text(camera))
    write_found(tmp_path / "set", find_strecha(folder))
    pairs = read_pair_set(tmp_path / "set").pairs
    assert len(pairs) == 6
    for pair in pairs:
        assert pair.scene == "fountain"
        assert pair.pair_id.startswith("fountain_Photo 1 of 4, café ")
        own = (scene_cameras()[int(path.stem[-1])] for path in (pair.image1, pair.image2))
        np.testing.assert_allclose(pair.fundamental(), fundamental_from_cameras(*own), atol=1e-7)
        assert len(pair.control_points()[0]) >= 12


def test_camera_files_and_their_photographs_are_checked(tmp_path):
    refused(find_strecha, tmp_path, r"no file \*\.camera")
    path = tmp_path / "a.png.camera"
    path.write_text(camera_text(scene_cameras()[0]))
    np.testing.assert_allclose(read_camera(path).t, scene_cameras()[0].t, atol=1e-9)
    for line, text, message in (
        (2, "1 2", r"a\.png\.camera, line 2: 2 numbers, expected 3"),
        (5, "1 0 x", r"a\.png\.camera, line 5: 'x' is not a finite number"),
        (6, "9 9 9", r"a\.png\.camera: R is not a rotation"),
        (9, "", r"a\.png\.camera: 8 rows, expected 9"),
    ):
        rows = camera_text(scene_cameras()[0]).splitlines()
        rows[line - 1] = text
        path.write_text("\n".join(rows))
        refused(read_camera, path, message)
    path.write_text(camera_text(scene_cameras()[0]))
    refused(find_strecha, tmp_path, r"a\.png\.camera: no image")
    save(tmp_path / "a.png", texture(100, 80))
    refused(find_strecha, tmp_path, r"a\.png\.camera: says 320 x 240, .* is 100 x 80")
