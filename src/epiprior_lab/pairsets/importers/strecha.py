"""Strecha's multi-view sets: laser-scanned cameras in ``<image>.camera`` files.

Format of a file: three rows of K; a row of three zeros; three rows of the rotation from camera to world; the centre of
the camera; width and height. Pixels count from the centre of the top-left pixel, as far as we know: no document that
we have says so. The files hold no points: control points are triangulated from SIFT matches with the given cameras.
"""

from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.pairsets import Camera, DatasetError, image_size
from epiprior_lab.pairsets.cameras import CameraError
from epiprior_lab.pairsets.files import read_numbers
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of
from epiprior_lab.pairsets.importers.photos import Matched, mapping_options, matched
from epiprior_lab.pairsets.importers.sources import files_of
from epiprior_lab.pairsets.importers.structure import DEFAULT_CHOICE, HALF_PIXEL, PairChoice, choose_pairs, views_of

_ENDING = ".camera"
_WIDTHS = (3, 3, 3, 3, 3, 3, 3, 3, 2)


def read_camera(path: Path) -> Camera:
    """Return the camera of a ``.camera`` file; DatasetError names the file, and the line of a wrong row."""
    lines = read_numbers(path)
    if len(lines) != len(_WIDTHS):
        raise DatasetError(f"{path}: {len(lines)} rows, expected {len(_WIDTHS)}: K, zeros, rotation, centre, size")
    for (line, values), width in zip(lines, _WIDTHS, strict=True):
        if len(values) != width:
            raise DatasetError(f"{path}, line {line}: {len(values)} numbers, expected {width}")
    rows = [values for _, values in lines]
    R, centre = np.array(rows[4:7]).T, np.array(rows[7])
    try:
        return Camera(K=np.array(rows[:3]), R=R, t=-R @ centre, width=int(rows[8][0]), height=int(rows[8][1]))
    except CameraError as error:
        raise DatasetError(f"{path}: {error}") from error


def find_strecha(folder: Path, *, images: Path | None = None, choice: PairChoice = DEFAULT_CHOICE) -> list[FoundPair]:
    """Return pairs of a scene, or of each scene below a folder.

    Photographs are in the folder `images`, else beside the ``*.camera`` files, else in a folder ``images`` beside
    theirs. DatasetError if there is no camera file, one is damaged, or a photograph is missing or has another size;
    ImageError if one cannot be read; all of a scene are checked first.
    """
    files: dict[Path, list[Path]] = {}
    for path in files_of(folder, f"**/*{_ENDING}"):
        files.setdefault(path.parent, []).append(path)
    if not files:
        raise DatasetError(f"{folder}: no file *{_ENDING}")
    pairs = []
    for one, paths in files.items():
        beside = any(path.with_suffix("").is_file() for path in paths)
        scene = (one if beside else one.parent).resolve().name
        pairs += _scene(paths, images or (one if beside else one.parent / "images"), scene, choice)
    if not pairs:
        raise DatasetError(f"{folder}: no pair with {choice}")
    return pairs


def _scene(paths: list[Path], images: Path, scene: str, choice: PairChoice) -> list[FoundPair]:
    photographs = []
    for path in paths:
        photograph = images / path.name.removesuffix(_ENDING)
        if not photograph.is_file():
            raise DatasetError(f"{path}: no image {photograph}")
        camera = read_camera(path)
        width, height = image_size(photograph, turn=False)
        if (width, height) != (camera.width, camera.height):
            raise DatasetError(f"{path}: says {camera.width} x {camera.height}, {photograph} is {width} x {height}")
        photographs.append(Photograph(name=name_of(photograph.name), path=photograph, camera=camera))
    with matched(photographs) as found:
        views = views_of(_triangulate(found), found.photographs.__getitem__, prefix=f"{scene}_")
        return choose_pairs(views, scene, choice)


def _triangulate(found: Matched) -> Any:
    """Return a reconstruction with the given cameras, and points triangulated from the matches."""
    import pycolmap

    reconstruction = pycolmap.Reconstruction()
    known = pycolmap.Database.open(found.database)
    try:
        for image in known.read_all_images():
            camera = found.photographs[image.name].camera
            assert camera is not None
            K = camera.K
            params = [K[0, 0], K[1, 1], K[0, 2] + HALF_PIXEL, K[1, 2] + HALF_PIXEL]
            pinhole = pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=params)
            pinhole.camera_id, pinhole.has_prior_focal_length = image.camera_id, True
            known.update_camera(pinhole)
            reconstruction.add_camera_with_trivial_rig(pinhole)
            pose = pycolmap.Rigid3d(np.column_stack([camera.R, camera.t]))
            placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            reconstruction.add_image_with_trivial_frame(placed, pose)
    finally:
        known.close()
    return pycolmap.triangulate_points(
        reconstruction, found.database, found.images, found.scratch, options=mapping_options()
    )
