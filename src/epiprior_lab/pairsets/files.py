"""The files of a pair set: tables, matrices, depth maps and images; errors name the file and the line."""

import csv
import io
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError

from epiprior.errors import EpipriorError
from epiprior.features.images import read_image
from epiprior.types import Float32Array, FloatArray
from epiprior_lab.pairsets.cameras import Camera, CameraError

PAIR_COLUMNS = ("pair_id", "image1", "image2", "gt", "scene", "difficulty")
ROTATION_COLUMNS = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
CAMERA_COLUMNS = ("image", "width", "height", "fx", "fy", "cx", "cy", *ROTATION_COLUMNS, "t1", "t2", "t3")
POINT_COLUMNS = ("x1", "y1", "x2", "y2")

_KEPT_MANTISSA_BITS = 16
_ZIP_LEVEL = 1  # NumPy's own level, 6, takes five times as long for files that are 5 % smaller
_SEPARATORS = str.maketrans(",;\t", "   ")
_COMMENTS = ("#", "%", "//")
_ORIENTATION_TAG = 0x0112
_TURNED_BY_A_QUARTER = (5, 6, 7, 8)


class DatasetError(EpipriorError, ValueError):
    """A pair set is missing, incomplete or damaged; the message names the file and, in a table, the line."""


def read_text(path: Path) -> str:
    """Return the content of a UTF-8 file, line ends as they are; DatasetError if it cannot be read."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


def read_table(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line number and values of each row of a comma-separated table; DatasetError names file and line."""
    reader = csv.reader(io.StringIO(read_text(path), newline=""))
    header = next(reader, [])
    missing = [name for name in columns if name not in header]
    if missing:
        raise DatasetError(f"{path}, line 1: no column {missing[0]!r}, found {', '.join(header) or 'nothing'}")
    for row in filter(None, reader):
        if len(row) != len(header):
            raise DatasetError(f"{path}, line {reader.line_num}: {len(row)} values for {len(header)} columns")
        yield reader.line_num, dict(zip(header, row, strict=True))


def write_table(path: Path, columns: tuple[str, ...], rows: Iterable[list[str]]) -> None:
    """Write a comma-separated table with Unix line ends."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def number(text: str) -> float:
    """Return the finite number that `text` is, or NaN."""
    try:
        value = float(text)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _numbers(path: Path, line: int, row: dict[str, str], columns: tuple[str, ...]) -> list[float]:
    values = {name: number(row[name]) for name in columns}
    for name, value in values.items():
        if np.isnan(value):
            raise DatasetError(f"{path}, line {line}: {name} = {row[name]!r} is not a finite number")
    return list(values.values())


def read_numbers(path: Path, *, header: bool = False) -> list[tuple[int, list[float]]]:
    """Return the finite numbers of each line of a text file that has some, with the number of the line from 1.

    Blanks, tabs, commas and semicolons separate; lines that begin with ``#``, ``%`` or ``//`` are comments. With
    `header`, a first line without any number is passed over. DatasetError names file and line.
    """
    rows: list[tuple[int, list[float]]] = []
    for line, text in enumerate(read_text(path).splitlines(), 1):
        words = text.translate(_SEPARATORS).split()
        if not words or text.lstrip().startswith(_COMMENTS):
            continue
        values = [number(word) for word in words]
        if header and np.isnan(values).all():
            header = False
            continue
        header = False
        if np.isnan(values).any():
            wrong = words[int(np.isnan(values).argmax())]
            raise DatasetError(f"{path}, line {line}: {wrong!r} is not a finite number")
        rows.append((line, values))
    return rows


def read_cameras(path: Path) -> dict[str, Camera]:
    """Return the cameras of a ``cameras.csv`` by image; DatasetError if one is impossible or there twice."""
    cameras: dict[str, Camera] = {}
    for line, row in read_table(path, CAMERA_COLUMNS):
        width, height, fx, fy, cx, cy, *pose = _numbers(path, line, row, CAMERA_COLUMNS[1:])
        if row["image"] in cameras:
            raise DatasetError(f"{path}, line {line}: image {row['image']!r} is there twice")
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        R, t = np.array(pose[:9]).reshape(3, 3), np.array(pose[9:])
        try:
            cameras[row["image"]] = Camera(K=K, R=R, t=t, width=int(width), height=int(height))
        except CameraError as error:
            raise DatasetError(f"{path}, line {line}: {error}") from error
    return cameras


def write_tables(root: Path, pairs: Iterable[list[str]], cameras: Mapping[str, Camera]) -> None:
    """Write ``pairs.csv``, and where there are cameras by image ``cameras.csv``; DatasetError if one has a skew."""
    write_table(root / "pairs.csv", PAIR_COLUMNS, pairs)
    if cameras:
        write_table(root / "cameras.csv", CAMERA_COLUMNS, (_camera_row(*item) for item in cameras.items()))


def _camera_row(image: str, camera: Camera) -> list[str]:
    """Return a row of ``cameras.csv``, floats as their shortest exact text; DatasetError if the camera has a skew."""
    K = camera.K
    if abs(K[0, 1]) > 1e-6 * K[0, 0]:
        raise DatasetError(f"camera of {image!r}: a skew of {K[0, 1]:g} px cannot be written")
    numbers = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.R.ravel(), *camera.t]
    return [image, str(camera.width), str(camera.height), *(repr(float(value)) for value in numbers)]


def read_control_points(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return matched points as two arrays of shape (N, 2), pixels; DatasetError if the file is damaged."""
    rows = [_numbers(path, line, row, POINT_COLUMNS) for line, row in read_table(path, POINT_COLUMNS)]
    points = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return np.ascontiguousarray(points[:, :2]), np.ascontiguousarray(points[:, 2:])


def write_control_points(path: Path, x1: FloatArray, x2: FloatArray) -> None:
    """Write matched points, two arrays of shape (N, 2), with a millionth of a pixel."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, POINT_COLUMNS, ([f"{value:.6f}" for value in row] for row in np.column_stack([x1, x2])))


def read_matrix(path: Path) -> FloatArray:
    """Return the 3 x 3 matrix of a text file (see `read_numbers`); DatasetError if the file has another shape."""
    rows = read_numbers(path)
    for line, values in rows:
        if len(values) != 3:
            raise DatasetError(f"{path}, line {line}: {len(values)} numbers, expected 3")
    if len(rows) != 3:
        raise DatasetError(f"{path}: {len(rows)} rows of a matrix, expected 3")
    return np.array([values for _, values in rows])


def write_matrix(path: Path, matrix: FloatArray) -> None:
    """Write a 3 x 3 matrix as three lines of text, floats as their shortest exact text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(" ".join(repr(float(value)) for value in row) + "\n" for row in matrix), encoding="utf-8")


def npz_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return an ``.npz`` file that `numpy.load` reads; the same arrays in the same order give the same bytes."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_DEFLATED, _ZIP_LEVEL)
    return archive.getvalue()


def encode_depth(depth: Float32Array) -> bytes:
    """Return a depth map as the bytes of an ``.npz`` file with the key ``depth``.

    Depths are rounded to 16 bits of mantissa: a relative error below 1e-5, under a hundredth of a pixel when
    reprojected, and a file half as long.
    """
    bits = np.ascontiguousarray(depth, dtype=np.float32).view(np.uint32)
    dropped = 23 - _KEPT_MANTISSA_BITS
    half, mask = np.uint32(1 << (dropped - 1)), np.uint32(0xFFFFFFFF ^ ((1 << dropped) - 1))
    rounded = np.where(np.isfinite(depth), (bits + half) & mask, bits).astype(np.uint32).view(np.float32)
    return npz_bytes({"depth": rounded})


def read_depth(path: Path) -> Float32Array:
    """Return a depth map, shape (height, width), inf where nothing is seen; DatasetError if the file holds none."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            depth = np.asarray(archive["depth"], dtype=np.float32)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path}: cannot be read as a depth map: {error}") from error
    if depth.ndim != 2:
        raise DatasetError(f"{path}: depth has shape {depth.shape}, expected (height, width)")
    return np.where(depth > 0, depth, np.float32(np.inf))


def image_size(path: Path, *, turn: bool = True) -> tuple[int, int]:
    """Return width and height by the header, turned as EXIF says unless `turn` is False; DatasetError if damaged."""
    try:
        with PillowImage.open(path) as image:
            width, height = image.size
            exif = PillowImage.Exif()
            exif.load(image.info.get("exif", b""))  # `getexif` would decode the pixels of a PNG file
            turned = turn and exif.get(_ORIENTATION_TAG) in _TURNED_BY_A_QUARTER
    except UnidentifiedImageError as error:
        raise DatasetError(f"{path}: is no image") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as an image: {error}") from error
    return (height, width) if turned else (width, height)


def check_pixels(path: Path) -> None:
    """Decode an image, at an eighth of its size where the format allows that; ImageError if it cannot be read."""
    read_image(path, cv2.IMREAD_REDUCED_GRAYSCALE_8)
