"""Numbers in the text files of published sets: separated by blanks, tabs, commas or semicolons."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_lines

_SEPARATORS = str.maketrans(",;\t", "   ")
_COMMENTS = ("#", "%", "//")


def read_rows(path: Path, widths: tuple[int, ...]) -> tuple[FloatArray, list[int]]:
    """Return the rows of a table of numbers, and the line of each.

    Parameters
    ----------
    path : Path
        Lines that begin with ``#``, ``%`` or ``//``, and a first line without any number, are passed over. A first
        line with a single whole number counts the rows, as in the files of USAC.
    widths : tuple of int
        Numbers of columns that are possible.

    Returns
    -------
    rows : ndarray, shape (N, width), float64
        All finite; N may be 0.
    lines : list of int
        From 1.

    Raises
    ------
    DatasetError
        If the file cannot be read, a value is not a finite number, a row has another number of columns than is
        possible or than the first row, or the count is wrong.
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    count: int | None = None
    for index, (line, text) in enumerate(read_lines(path)):
        values = text.translate(_SEPARATORS).split()
        if text.strip().startswith(_COMMENTS) or (index == 0 and not any(_is_number(value) for value in values)):
            continue
        if not rows and count is None and len(values) == 1 and 1 not in widths and values[0].isdecimal():
            count = int(values[0])
            continue
        wrong = [value for value in values if not _is_number(value)]
        if wrong:
            raise DatasetError(f"{path}, line {line}: {wrong[0]!r} is not a finite number")
        allowed = (len(rows[0]),) if rows else widths
        if len(values) not in allowed:
            raise DatasetError(f"{path}, line {line}: {len(values)} numbers, expected {_either(allowed)}")
        rows.append([float(value) for value in values])
        lines.append(line)
    if count is not None and count != len(rows):
        raise DatasetError(f"{path}: line 1 announces {count} rows, there are {len(rows)}")
    return np.array(rows, dtype=np.float64).reshape(len(rows), -1 if rows else widths[0]), lines


def split_matches(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both points (N, 2) of rows ``x1 y1 x2 y2`` or ``x1 y1 w1 x2 y2 w2`` with whatever follows.

    Four columns are the first form, six or more the second.
    """
    if rows.shape[1] == 4:
        return rows[:, :2], rows[:, 2:]
    return rows[:, :2] / rows[:, 2:3], rows[:, 3:5] / rows[:, 5:6]


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _either(widths: tuple[int, ...]) -> str:
    return " or ".join(str(width) for width in widths)
