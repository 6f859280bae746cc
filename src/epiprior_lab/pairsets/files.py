"""Reading of the files of a pair set, with errors that name file and line."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from epiprior.errors import EpipriorError
from epiprior.types import Float32Array, FloatArray
from epiprior_lab.pairsets.archives import npz_bytes
from epiprior_lab.pairsets.cameras import Camera, CameraError

PAIR_COLUMNS = ("pair_id", "image1", "image2", "gt", "scene", "difficulty")
ROTATION_COLUMNS = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
CAMERA_COLUMNS = ("image", "width", "height", "fx", "fy", "cx", "cy", *ROTATION_COLUMNS, "t1", "t2", "t3")
POINT_COLUMNS = ("x1", "y1", "x2", "y2")
_KEPT_MANTISSA_BITS = 16


class DatasetError(EpipriorError, ValueError):
    """A pair set is missing, incomplete or damaged; the message names the file and, in a table, the line."""


def read_table(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the line number and the values of each row of a comma-separated table.

    Raises
    ------
    DatasetError
        If the file cannot be read, lacks a column, or a row has another number of values than the header.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error
    reader = csv.reader(io.StringIO(text))
    header = next(reader, [])
    missing = [name for name in columns if name not in header]
    if missing:
        raise DatasetError(f"{path}, line 1: no column {missing[0]!r}, found {', '.join(header) or 'nothing'}")
    for row in reader:
        if not row:
            continue
        if len(row) != len(header):
            raise DatasetError(f"{path}, line {reader.line_num}: {len(row)} values for {len(header)} columns")
        yield reader.line_num, dict(zip(header, row, strict=True))


def _numbers(path: Path, line: int, row: dict[str, str], columns: tuple[str, ...]) -> list[float]:
    """Return the finite numbers of some columns of a row."""
    values = []
    for name in columns:
        try:
            value = float(row[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise DatasetError(f"{path}, line {line}: {name} = {row[name]!r} is not a finite number")
        values.append(value)
    return values


def read_cameras(path: Path) -> dict[str, Camera]:
    """Return the cameras of a ``cameras.csv`` by the image they belong to.

    Raises
    ------
    DatasetError
        If the file cannot be read, an image is there twice, or a camera is impossible.
    """
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


def read_control_points(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return matched points as two arrays of shape (N, 2), pixels.

    Raises
    ------
    DatasetError
        If the file cannot be read or a value is not a finite number.
    """
    rows = [_numbers(path, line, row, POINT_COLUMNS) for line, row in read_table(path, POINT_COLUMNS)]
    points = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return np.ascontiguousarray(points[:, :2]), np.ascontiguousarray(points[:, 2:])


def read_matrix(path: Path) -> FloatArray:
    """Return the 3 x 3 matrix of a text file: three rows of three numbers, blanks or commas between.

    Raises
    ------
    DatasetError
        If the file cannot be read, a value is not a finite number, or the shape is another.
    """
    rows = []
    for line, text in read_lines(path):
        values = _floats(text.replace(",", " ").split())
        if len(values) != 3 or not np.isfinite(values).all():
            raise DatasetError(f"{path}, line {line}: {text.strip()!r} are not three finite numbers")
        rows.append(values)
    if len(rows) != 3:
        raise DatasetError(f"{path}: {len(rows)} rows of a matrix, expected 3")
    return np.array(rows)


def read_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a text file that are not blank, with their numbers from 1.

    Raises
    ------
    DatasetError
        If the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error
    return [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]


def _floats(values: list[str]) -> list[float]:
    """Return numbers, NaN where a text is none."""
    numbers = []
    for value in values:
        try:
            numbers.append(float(value))
        except ValueError:
            numbers.append(float("nan"))
    return numbers


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
    """Return a depth map, shape (height, width); inf where nothing is seen.

    Raises
    ------
    DatasetError
        If the file cannot be read or holds no two-dimensional ``depth``.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            depth = np.asarray(archive["depth"], dtype=np.float32)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path}: cannot be read as a depth map: {error}") from error
    if depth.ndim != 2:
        raise DatasetError(f"{path}: depth has shape {depth.shape}, expected (height, width)")
    return np.where(depth > 0, depth, np.float32(np.inf))
