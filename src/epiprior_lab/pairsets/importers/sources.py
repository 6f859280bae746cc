"""What importers find in a downloaded folder: files, images that belong to a name, matches as text or MATLAB values."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from epiprior.features.images import is_hidden_copy
from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_numbers

logger = logging.getLogger(__name__)

SUFFIXES = (".jpg", ".jpeg", ".png", ".ppm", ".pgm", ".bmp", ".tif", ".tiff")


def need_folder(path: Path) -> Path:
    """Return `path`; DatasetError where it is no folder."""
    if not path.is_dir():
        raise DatasetError(f"{path}: no such folder")
    return path


def files_of(folder: Path, pattern: str) -> list[Path]:
    """Return the files of a folder that match a pattern, by name; ``._*`` of macOS are skipped with one warning."""
    found = sorted(path for path in need_folder(folder).glob(pattern) if path.is_file())
    kept = [path for path in found if not is_hidden_copy(path.name)]
    if len(kept) < len(found):
        logger.warning("%s: %d files ._* skipped: attributes that macOS keeps", folder, len(found) - len(kept))
    return kept


def image_of(folder: Path, stem: str, wanted_by: Path) -> Path:
    """Return the one image ``<stem>.<suffix>`` of a folder; DatasetError names the file that needs it."""
    found = sorted(path for path in folder.iterdir() if path.stem == stem and path.suffix.lower() in SUFFIXES)
    if not found:
        raise DatasetError(f"{wanted_by}: no image {folder / stem} with one of {', '.join(SUFFIXES)}")
    if len(found) > 1:
        raise DatasetError(f"{wanted_by}: both {found[0]} and {found[1].name} are there")
    return found[0]


def read_rows(path: Path, widths: tuple[int, ...]) -> FloatArray:
    """Return a table of numbers in text, shape (N, width), with one of the `widths`; N may be 0.

    A first line without any number is passed over; one with a single whole number counts the rows, as in the files of
    USAC. DatasetError if a line is damaged, rows differ in length, or the count is wrong.
    """
    lines = read_numbers(path, header=True)
    if lines and len(lines[0][1]) == 1 and 1 not in widths and lines[0][1][0].is_integer():
        count = int(lines.pop(0)[1][0])
        if count != len(lines):
            raise DatasetError(f"{path}: line 1 announces {count} rows, there are {len(lines)}")
    rows: list[list[float]] = []
    for line, values in lines:
        allowed = (len(rows[0]),) if rows else widths
        if len(values) not in allowed:
            raise DatasetError(f"{path}, line {line}: {len(values)} numbers, expected {' or '.join(map(str, allowed))}")
        rows.append(values)
    return np.array(rows, dtype=np.float64).reshape(len(rows), -1 if rows else widths[0])


def split_matches(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both points (N, 2) of rows ``x1 y1 x2 y2`` or ``x1 y1 w1 x2 y2 w2`` with whatever follows.

    Four columns are the first form, six or more the second.
    """
    if rows.shape[1] == 4:
        return rows[:, :2], rows[:, 2:]
    return rows[:, :2] / rows[:, 2:3], rows[:, 3:5] / rows[:, 5:6]


def read_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file (before version 7.3); structures are objects with attributes."""
    try:
        return dict(scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True))
    except NotImplementedError as error:
        raise DatasetError(f"{path}: is a MATLAB file of version 7.3; save it with -v7") from error
    except Exception as error:  # a damaged file raises whatever its bytes lead to
        raise DatasetError(f"{path}: cannot be read as a MATLAB file: {error}") from error


def matches_of_mat(path: Path, value: object, name: str) -> tuple[FloatArray, FloatArray]:
    """Return both points (N, 2), none at infinity, of six rows of homogeneous coordinates, those of image 1 first."""
    try:
        data = np.atleast_2d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {name} is no matrix of numbers") from error
    if data.shape == (1, 6):
        data = data.T  # a single match, squeezed
    if data.ndim != 2 or data.shape[0] != 6:
        raise DatasetError(f"{path}: {name} has shape {data.shape}, expected (6, number of points)")
    if not np.isfinite(data).all() or not (data[[2, 5]] != 0).all():
        raise DatasetError(f"{path}: {name} holds a value that is not finite, or a point at infinity")
    return split_matches(data.T)
