"""Strecha's multi-view sets: laser-scanned cameras in ``<image>.camera`` files.

Format of a file: three rows of K; a row of three zeros; three rows of the rotation from camera to world; the centre of
the camera; width and height. Pixels count from the centre of the top-left pixel, as far as we know: no document that
we have says so. The files hold no points: control points are triangulated from SIFT matches with the given cameras.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from epiprior_lab.pairsets import Camera, DatasetError, image_size
from epiprior_lab.pairsets.cameras import CameraError
from epiprior_lab.pairsets.files import read_lines
from epiprior_lab.pairsets.importers.images_beside import need_folder
from epiprior_lab.pairsets.importers.output import FoundPair
from epiprior_lab.pairsets.importers.pycolmap_run import match_images, quiet, triangulate
from epiprior_lab.pairsets.importers.structure import PairChoice, choose_pairs, views_of

_ENDING = ".camera"
_WIDTHS = (3, 3, 3, 3, 3, 3, 3, 3, 2)
_FEATURES_SIDE = 1600


def read_camera(path: Path) -> Camera:
    """Return the camera of a ``.camera`` file.

    Raises
    ------
    DatasetError
        If the file cannot be read, a row has another number of values, or the camera is impossible; the message names
        file and line.
    """
    rows = []
    lines = read_lines(path)
    if len(lines) != len(_WIDTHS):
        raise DatasetError(f"{path}: {len(lines)} rows, expected {len(_WIDTHS)}: K, zeros, rotation, centre, size")
    for (line, text), width in zip(lines, _WIDTHS, strict=True):
        try:
            values = [float(value) for value in text.split()]
        except ValueError as error:
            raise DatasetError(f"{path}, line {line}: {text.strip()!r} are not numbers") from error
        if len(values) != width or not np.isfinite(values).all():
            raise DatasetError(f"{path}, line {line}: {text.strip()!r}, expected {width} finite numbers")
        rows.append(values)
    K, rotation, centre = np.array(rows[:3]), np.array(rows[4:7]), np.array(rows[7])
    R = rotation.T
    try:
        return Camera(K=K, R=R, t=-R @ centre, width=int(rows[8][0]), height=int(rows[8][1]))
    except CameraError as error:
        raise DatasetError(f"{path}: {error}") from error


def find_strecha(folder: Path, *, images: Path | None = None, choice: PairChoice | None = None) -> list[FoundPair]:
    """Return pairs of a scene, or of each scene below a folder.

    Parameters
    ----------
    folder : Path
        ``*.camera`` files; the photographs beside them, or in a folder ``images`` beside theirs.
    images : Path, optional
        Folder of the photographs, where there is one scene.
    choice : PairChoice, optional
        Which pairs.

    Raises
    ------
    DatasetError
        If there is no camera file, one is damaged, or a photograph is missing or has another size.
    """
    choice = choice or PairChoice()
    folders = sorted({path.parent for path in need_folder(folder).rglob(f"*{_ENDING}")})
    if not folders:
        raise DatasetError(f"{folder}: no file *{_ENDING}")
    pairs = []
    for one in folders:
        beside = any((one / path.name.removesuffix(_ENDING)).is_file() for path in one.glob(f"*{_ENDING}"))
        photographs = images or (one if beside else one.parent / "images")
        scene = (one if beside else one.parent).resolve().name
        pairs += _scene(one, photographs, scene, choice)
    if not pairs:
        raise DatasetError(f"{folder}: no pair with {choice}")
    return pairs


def _scene(folder: Path, images: Path, scene: str, choice: PairChoice) -> list[FoundPair]:
    cameras = {}
    for path in sorted(folder.glob(f"*{_ENDING}")):
        name = path.name.removesuffix(_ENDING)
        photograph = images / name
        if not photograph.is_file():
            raise DatasetError(f"{path}: no image {photograph}")
        camera = read_camera(path)
        width, height = image_size(photograph)
        if (width, height) != (camera.width, camera.height):
            raise DatasetError(f"{path}: says {camera.width} x {camera.height}, {photograph} is {width} x {height}")
        cameras[name] = camera
    with tempfile.TemporaryDirectory() as scratch, quiet():
        database = Path(scratch) / "database.db"
        match_images(database, images, list(cameras), max_side=_FEATURES_SIDE)
        reconstruction = triangulate(database, images, Path(scratch) / "model", cameras)
        return choose_pairs(views_of(reconstruction, images, prefix=f"{scene}_"), scene, choice)
