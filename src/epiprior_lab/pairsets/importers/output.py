"""What an importer found, and writing it as a pair set."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.errors import OutputError
from epiprior.types import FloatArray
from epiprior_lab.pairsets import Camera, DatasetError, PairSet, image_size, read_pair_set, write_control_points
from epiprior_lab.pairsets.files import CAMERA_COLUMNS, PAIR_COLUMNS
from epiprior_lab.pairsets.homographies import grid_in_both, transfer
from epiprior_lab.pairsets.importers.progress import progress_bar
from epiprior_lab.pairsets.writer import camera_row, write_matrix, write_table

Pixels = NDArray[np.uint8]

DEFAULT_MAX_SIDE = 1280
_COPIED = {".jpg", ".jpeg", ".png", ".ppm", ".pgm"}
_JPEG_QUALITY = 95


@dataclass(frozen=True, kw_only=True, eq=False)
class Photograph:
    """An image of a published set.

    Parameters
    ----------
    name : str
        Stem of its file in the new set; unique there.
    path : Path
        Where it comes from.
    camera : Camera, optional
        Of the pixels as they are before they are made smaller.
    develop : callable, optional
        Returns the pixels where they are not those of the file: undistorted, or part of a larger file.
    """

    name: str
    path: Path
    camera: Camera | None = None
    develop: Callable[[], Pixels] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundPair:
    """Two photographs and what is known of them: cameras, a homography, an F, or only control points.

    Coordinates are pixels of the photographs before they are made smaller, the centre of the top-left pixel at (0, 0).

    Parameters
    ----------
    pair_id, scene, difficulty : str
        As in ``pairs.csv``.
    image1, image2 : Photograph
        Both with cameras or both without.
    points : tuple of ndarray, optional
        Control points, two arrays of shape (N, 2).
    homography, fundamental : ndarray, shape (3, 3), optional
        ``x2 ~ H x1``; ``x2' F x1 = 0``. At most one of them, and not with cameras. A homography without control
        points gets a grid of them.
    """

    pair_id: str
    scene: str
    image1: Photograph
    image2: Photograph
    difficulty: str = ""
    points: tuple[FloatArray, FloatArray] | None = None
    homography: FloatArray | None = None
    fundamental: FloatArray | None = None

    @property
    def gt(self) -> str:
        """The column of ``pairs.csv``."""
        if self.image1.camera is not None:
            return "cameras"
        if self.homography is not None:
            return "homography"
        return "control_points" if self.fundamental is None else "fundamental"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Written:
    """An image in the new set: `to_new` takes its old pixels to the new ones."""

    file: str
    size: tuple[int, int]
    to_new: FloatArray


def write_found(out: Path, pairs: Sequence[FoundPair], *, max_side: int = DEFAULT_MAX_SIDE) -> PairSet:
    """Write pairs as a new pair set, read it back and so check it.

    Parameters
    ----------
    out : Path
        Folder of the set; must not exist.
    pairs : sequence of FoundPair
        At least one; ids are unique.
    max_side : int
        Larger images are made smaller, and everything with them, pixels. Smaller ones are copied as they are.

    Returns
    -------
    PairSet
        What was written.

    Raises
    ------
    OutputError
        If `out` exists or cannot be written.
    DatasetError
        If there is no pair, an image cannot be read, or the set does not pass the check of `read_pair_set`. What was
        written until then stays in ``<out>.partial``.
    """
    check_out(out)
    if not pairs:
        raise DatasetError(f"{out}: no pair was found")
    partial = out.with_name(out.name + ".partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        (partial / "images").mkdir(parents=True)
        _write(partial, pairs, max_side)
        pair_set = read_pair_set(partial)
        partial.rename(out)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error}") from error
    return PairSet(name=out.resolve().name, pairs=pair_set.pairs)


def check_out(out: Path) -> None:
    """Raise OutputError, before any work is done, where `out` exists."""
    if out.exists():
        raise OutputError(f"{out}: exists already; a pair set is not overwritten")


def _write(root: Path, pairs: Sequence[FoundPair], max_side: int) -> None:
    pair_rows: list[list[str]] = []
    camera_rows: dict[str, list[str]] = {}
    written: dict[str, tuple[Photograph, _Written]] = {}
    with progress_bar("writing pairs", len(pairs)) as advance:
        for pair in pairs:
            for photograph in (pair.image1, pair.image2):
                known = written.get(photograph.name)
                if known is None:
                    new = _write_image(root, photograph, max_side)
                    written[photograph.name] = photograph, new
                    if photograph.camera is not None:
                        camera_rows[new.file] = camera_row(new.file, _scaled(photograph.camera, new))
                elif known[0].path != photograph.path:
                    raise DatasetError(f"{known[0].path} and {photograph.path} would both become {known[1].file}")
            image1, image2 = written[pair.image1.name][1], written[pair.image2.name][1]
            _write_truth(root, pair, image1, image2)
            pair_rows.append([pair.pair_id, image1.file, image2.file, pair.gt, pair.scene, pair.difficulty])
            advance()
    write_table(root / "pairs.csv", PAIR_COLUMNS, pair_rows)
    if camera_rows:
        write_table(root / "cameras.csv", CAMERA_COLUMNS, list(camera_rows.values()))


def _write_image(root: Path, photograph: Photograph, max_side: int) -> _Written:
    if photograph.develop is None:
        width, height = image_size(photograph.path)
        if max(width, height) <= max_side and photograph.path.suffix.lower() in _COPIED:
            file = f"images/{photograph.name}{photograph.path.suffix.lower()}"
            shutil.copyfile(photograph.path, root / file)
            return _Written(file=file, size=(width, height), to_new=np.eye(3))
        pixels = read_pixels(photograph.path)
    else:
        pixels = photograph.develop()
    height, width = pixels.shape[:2]
    factor = min(1.0, max_side / max(width, height))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    if size != (width, height):
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    file = f"images/{photograph.name}.jpg"
    (root / file).write_bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes())
    return _Written(file=file, size=size, to_new=shrinking((width, height), size))


def read_pixels(path: Path, *, turn: bool = True) -> Pixels:
    """Return the pixels of an image, BGR, turned as its EXIF data say unless `turn` is False.

    Raises
    ------
    DatasetError
        If the file cannot be read.
    """
    flags = cv2.IMREAD_COLOR if turn else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imread(str(path), flags) if path.is_file() else None
    if pixels is None:
        raise DatasetError(f"{path}: no image that OpenCV can read")
    return np.asarray(pixels, dtype=np.uint8)


def shrinking(old: tuple[int, int], new: tuple[int, int]) -> FloatArray:
    """Return the 3 x 3 map of pixels when an image of size `old` becomes `new` (width, height).

    Corners go to corners, and those lie half a pixel beside the outermost centres.
    """
    x, y = (after / before for before, after in zip(old, new, strict=True))
    return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


def _scaled(camera: Camera, new: _Written) -> Camera:
    K = new.to_new @ camera.K
    return Camera(K=K, R=camera.R, t=camera.t, width=new.size[0], height=new.size[1])


def _write_truth(root: Path, pair: FoundPair, image1: _Written, image2: _Written) -> None:
    """Write control points, homography and F in the new pixels."""
    to1, to2 = image1.to_new, image2.to_new
    points = None if pair.points is None else (transfer(to1, pair.points[0]), transfer(to2, pair.points[1]))
    if pair.homography is not None:
        H = to2 @ pair.homography @ np.linalg.inv(to1)
        write_matrix(root / "homography" / f"{pair.pair_id}.txt", H)
        if points is None:
            x1 = grid_in_both(H, image1.size, image2.size)
            points = x1, transfer(H, x1)
            if not len(x1):
                raise DatasetError(
                    f"pair {pair.pair_id!r}: the homography takes no point of {pair.image1.path} into "
                    f"{pair.image2.path}"
                )
    if pair.fundamental is not None:
        F = np.linalg.inv(to2).T @ pair.fundamental @ np.linalg.inv(to1)
        write_matrix(root / "fundamental" / f"{pair.pair_id}.txt", F / np.linalg.norm(F))
    if points is not None:
        write_control_points(root / "control_points" / f"{pair.pair_id}.csv", *points)
