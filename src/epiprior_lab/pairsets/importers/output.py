"""What an importer found, and writing it as a pair set."""

import contextlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from epiprior.errors import OutputError
from epiprior.features.images import read_image
from epiprior.types import FloatArray
from epiprior_lab.pairsets import Camera, DatasetError, PairSet, files, image_size, read_pair_set, write_control_points
from epiprior_lab.pairsets.changed import shrinking
from epiprior_lab.pairsets.homographies import grid_in_both, transfer

Pixels = NDArray[np.uint8]

_COPIED = {".jpg", ".jpeg", ".png", ".ppm", ".pgm"}
_JPEG_QUALITY = 95
_LONGEST_NAME = 250  # bytes, a suffix to come; file systems allow 255


def name_of(file: str) -> str:
    """Return the name of a photograph in the new set: its path without suffix, ``_`` for ``/``: scenes share names."""
    return Path(file).with_suffix("").as_posix().strip("/").replace("/", "_")


def as_text(name: str) -> str:
    """Return a name as ``pairs.csv``, which is UTF-8, can hold it: bytes that are not UTF-8 are taken for Latin-1."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return os.fsencode(name).decode("latin-1")
    return name


@contextlib.contextmanager
def progress_bar(description: str, total: int) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on a terminal; elsewhere a line is printed when the work is done."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task(description, total=total)
        yield lambda: progress.advance(bar)


@dataclass(frozen=True, kw_only=True, eq=False)
class Photograph:
    """An image of a published set; `name` is the stem of its file in the new set, unique there.

    `camera` is that of the pixels before they are made smaller; `develop` returns the pixels where they are not those
    of the file `path`: undistorted, or part of a larger file.
    """

    name: str
    path: Path
    camera: Camera | None = None
    develop: Callable[[], Pixels] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", as_text(self.name))


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundPair:
    """Two photographs and what is known of them: cameras, a homography, an F, or only control points.

    Coordinates are pixels of the photographs before they are made smaller, the centre of the top-left pixel at (0, 0).
    Both images have cameras, or neither, and at most one of `homography` and `fundamental` is given. `points` are two
    arrays (N, 2); a homography without any gets a grid of them.
    """

    pair_id: str
    scene: str
    image1: Photograph
    image2: Photograph
    difficulty: str = ""
    points: tuple[FloatArray, FloatArray] | None = None
    homography: FloatArray | None = None
    fundamental: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("pair_id", "scene"):
            object.__setattr__(self, name, as_text(getattr(self, name)))

    @property
    def gt(self) -> str:
        """The column of ``pairs.csv``."""
        if self.image1.camera is not None:
            return "cameras"
        if self.homography is not None:
            return "homography"
        return "control_points" if self.fundamental is None else "fundamental"


class _Written(NamedTuple):
    """An image in the new set: `to_new` (3 x 3) takes its old pixels to the new ones."""

    file: str
    size: tuple[int, int]
    to_new: FloatArray


def check_out(out: Path) -> None:
    """Raise OutputError, before any work is done, where `out` exists."""
    if out.exists():
        raise OutputError(f"{out}: exists already; a pair set is not overwritten")


def check_photographs(photographs: Iterable[Photograph]) -> None:
    """Raise, before any work is done, where two files have one name in a pair set or an image cannot be decoded."""
    known: dict[str, Path] = {}
    for photograph in photographs:
        name, path = photograph.name, photograph.path
        if name in known and known[name] != path:
            raise DatasetError(f"{known[name]} and {path} would both become images/{name}")
        if name not in known and (photograph.develop is None or path.is_file()):  # else part of a file, read with it
            files.check_pixels(path)
        known[name] = path


def write_found(out: Path, pairs: Sequence[FoundPair], *, max_side: int = 1280) -> PairSet:
    """Write pairs as a new pair set, read it back and so check it.

    Images larger than `max_side` pixels are made smaller, and everything with them; others are copied as they are.
    OutputError if `out` exists or cannot be written. DatasetError or ImageError if there is no pair, a name cannot be
    that of a file, two photographs have one name or one cannot be read, all before anything is written; or if the set
    does not pass the check of `read_pair_set`. What was written until then stays in ``<out>.partial``.
    """
    check_out(out)
    if not pairs:
        raise DatasetError(f"{out}: no pair was found")
    for name in (pair.pair_id for pair in pairs):
        if "/" in name or len(name.encode()) > _LONGEST_NAME:
            raise DatasetError(f"pair {name!r}: a pair set has files of this name: no '/', {_LONGEST_NAME} bytes")
    check_photographs(photograph for pair in pairs for photograph in (pair.image1, pair.image2))
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


def _write(root: Path, pairs: Sequence[FoundPair], max_side: int) -> None:
    rows: list[list[str]] = []
    cameras: dict[str, Camera] = {}
    written: dict[str, _Written] = {}
    with progress_bar("writing pairs", len(pairs)) as advance:
        for pair in pairs:
            for photograph in (pair.image1, pair.image2):
                if photograph.name in written:
                    continue
                new = written[photograph.name] = _write_image(root, photograph, max_side)
                if photograph.camera is not None:
                    K, (width, height) = new.to_new @ photograph.camera.K, new.size
                    cameras[new.file] = replace(photograph.camera, K=K, width=width, height=height)
            image1, image2 = written[pair.image1.name], written[pair.image2.name]
            _write_truth(root, pair, image1, image2)
            rows.append([pair.pair_id, image1.file, image2.file, pair.gt, pair.scene, pair.difficulty])
            advance()
    files.write_tables(root, rows, cameras)


def _write_image(root: Path, photograph: Photograph, max_side: int) -> _Written:
    if photograph.develop is None:
        width, height = image_size(photograph.path)
        if max(width, height) <= max_side and photograph.path.suffix.lower() in _COPIED:
            file = f"images/{photograph.name}{photograph.path.suffix.lower()}"
            shutil.copyfile(photograph.path, root / file)
            return _Written(file, (width, height), np.eye(3))
        pixels = read_image(photograph.path, cv2.IMREAD_COLOR)
    else:
        pixels = photograph.develop()
    height, width = pixels.shape[:2]
    factor = min(1.0, max_side / max(width, height))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    if size != (width, height):
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    file = f"images/{photograph.name}.jpg"
    (root / file).write_bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes())
    return _Written(file, size, shrinking((width, height), size))


def _write_truth(root: Path, pair: FoundPair, image1: _Written, image2: _Written) -> None:
    to1, to2 = image1.to_new, image2.to_new
    points = None if pair.points is None else (transfer(to1, pair.points[0]), transfer(to2, pair.points[1]))
    if pair.homography is not None:
        H = to2 @ pair.homography @ np.linalg.inv(to1)
        files.write_matrix(root / "homography" / f"{pair.pair_id}.txt", H)
        if points is None:
            x1 = grid_in_both(H, image1.size, image2.size)
            points = x1, transfer(H, x1)
            if not len(x1):
                where = f"{pair.image1.path} into {pair.image2.path}"
                raise DatasetError(f"pair {pair.pair_id!r}: the homography takes no point of {where}")
    if pair.fundamental is not None:
        F = np.linalg.inv(to2).T @ pair.fundamental @ np.linalg.inv(to1)
        files.write_matrix(root / "fundamental" / f"{pair.pair_id}.txt", F / np.linalg.norm(F))
    if points is not None:
        write_control_points(root / "control_points" / f"{pair.pair_id}.csv", *points)
