"""Matches as a table, one row per match: CSV for people and other programs, NPZ without any rounding.

Columns: ``set`` (0, 1, ...: one set of matches per roll hypothesis) and its ``roll_deg``, then those of
`MatchSet`: ``x1, y1, x2, y2, probability, supporting_matrices, distance_ratio, similarity_weight, similarity,
two_keypoint_probability, scale1, scale2, orientation1_deg, orientation2_deg, feature1, feature2``. Of a set
the best match comes first. A probability that is not known is an empty cell in CSV and NaN in NPZ. The rough
matrices of a set and the sizes of the images are not kept.
"""

import csv
import io
import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError
from epiprior.io.output import check_output, replacing
from epiprior.types import MatchSet, RankedMatches

TABLES = (".csv", ".npz")

_POINTS = {"x1": ("x1", 0), "y1": ("x1", 1), "x2": ("x2", 0), "y2": ("x2", 1)}
_RANKING = ("probability", "supporting_matrices", "distance_ratio", "similarity_weight", "similarity")
_FRAMES = ("scale1", "scale2", "orientation1_deg", "orientation2_deg", "feature1", "feature2")
_PLAIN = (*_RANKING, "two_keypoint_probability", *_FRAMES)
COLUMNS = ("set", "roll_deg", *_POINTS, *_PLAIN)
_INTEGERS = ("set", "supporting_matrices", "feature1", "feature2")
_TYPES = {name: np.dtype(np.int64 if name in _INTEGERS else np.float64) for name in COLUMNS}

Columns = dict[str, NDArray[Any]]


def write_matches(path: str | Path, matches: MatchSet | RankedMatches | Sequence[MatchSet]) -> None:
    """Write matches to a CSV or NPZ file, by the suffix of `path`; a file is replaced only as a whole.

    Parameters
    ----------
    path : Ends in ``.csv`` (nine significant digits, which is more than float32 holds) or ``.npz`` (exact).
    matches : Of `RankedMatches`, all sets, not the standard matches. A set without matches leaves no rows.

    Raises
    ------
    OutputError : If the suffix is unknown, the folder is missing, or writing fails; the message names the path.
    """
    path = Path(path)
    check_output(path, TABLES)
    if isinstance(matches, RankedMatches):
        sets: Sequence[MatchSet] = matches.sets
    else:
        sets = (matches,) if isinstance(matches, MatchSet) else matches
    columns = _columns_of(sets)
    with replacing(path) as partial:
        if path.suffix.lower() == ".csv":
            partial.write_text(_as_csv(columns), encoding="utf-8", newline="")
        else:
            with partial.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **columns)


def read_matches(path: str | Path) -> tuple[MatchSet, ...]:
    """Read what `write_matches` wrote: one set per value of ``set``, ascending; none for a table without rows.

    Columns may be in any order, further ones are ignored.

    Raises
    ------
    FeatureError : If the file is missing, no such table, lacks a column, or holds something else than numbers; the
        message names the file and the line or column.
    """
    path = Path(path)
    if path.suffix.lower() not in TABLES:
        raise FeatureError(f"{path}: unknown suffix {path.suffix!r}, known: {', '.join(TABLES)}")
    try:
        columns = _from_csv(path) if path.suffix.lower() == ".csv" else _from_npz(path)
    except OSError as error:
        raise FeatureError(f"{path}: cannot be read: {error.strerror or error}") from error
    index = columns["set"].astype(np.int64)
    return tuple(_set_of(path, columns, index == i) for i in np.unique(index))


def _columns_of(sets: Sequence[MatchSet]) -> Columns:
    """Return the sets one below the other, as columns in the order of COLUMNS."""
    parts = [
        {"set": np.full(len(s), i), "roll_deg": np.full(len(s), s.roll_deg)}
        | {name: getattr(s, field)[:, axis] for name, (field, axis) in _POINTS.items()}
        | {name: getattr(s, name) for name in _PLAIN}
        for i, s in enumerate(sets)
    ]
    return {
        name: np.concatenate([np.empty(0, dtype), *(part[name] for part in parts)]).astype(dtype)
        for name, dtype in _TYPES.items()
    }


def _as_csv(columns: Columns) -> str:
    cells = (
        [str(v) if isinstance(v, int) else "" if math.isnan(v) else f"{v:.9g}" for v in column.tolist()]
        for column in columns.values()
    )
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([columns, *zip(*cells, strict=True)])
    return out.getvalue()


def _from_csv(path: Path) -> Columns:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = next(reader, [])
            _require_columns(path, header)
            numbered = [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FeatureError(f"{path}: not a CSV table: {error}") from error
    for line, row in numbered:
        if len(row) != len(header):
            raise FeatureError(f"{path}: line {line} has {len(row)} cells, the header {len(header)}")
    place = {name: header.index(name) for name in COLUMNS}
    return {name: _numbers(path, name, [(line, row[place[name]]) for line, row in numbered]) for name in COLUMNS}


def _numbers(path: Path, name: str, cells: Sequence[tuple[int, str]]) -> NDArray[Any]:
    values: list[float | int] = []
    for line, cell in cells:
        try:
            values.append(int(cell) if name in _INTEGERS else float(cell or "nan"))
        except ValueError as error:
            raise FeatureError(f"{path}: line {line}, column {name}: {cell!r} is not a number") from error
    return np.array(values, dtype=_TYPES[name])


def _from_npz(path: Path) -> Columns:
    try:
        with np.load(path, allow_pickle=False) as data:
            _require_columns(path, list(data))
            columns = {name: data[name] for name in COLUMNS}
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, FeatureError):
            raise
        raise FeatureError(f"{path}: not an NPZ file of matches: {error}") from error
    for name, column in columns.items():
        kinds = "iu" if name in _INTEGERS else "iuf"
        if column.shape != (len(columns["set"]),) or column.dtype.kind not in kinds:
            raise FeatureError(f"{path}: column {name} has shape {column.shape} and type {column.dtype}")
    return columns


def _require_columns(path: Path, header: Sequence[str]) -> None:
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise FeatureError(f"{path}: lacks the column {missing[0]}")


def _set_of(path: Path, columns: Columns, rows: NDArray[np.bool_]) -> MatchSet:
    part: dict[str, Any] = {name: columns[name][rows].astype(dtype) for name, dtype in _TYPES.items()}
    for name, column in part.items():
        # Only a probability may be unknown.
        if name != "probability" and not np.isfinite(column).all():
            raise FeatureError(f"{path}: column {name} holds an empty, NaN or infinite value")
    rolls = np.unique(part["roll_deg"])
    if len(rolls) != 1:
        raise FeatureError(f"{path}: set {part['set'][0]} has {len(rolls)} different values of roll_deg")
    x1, x2 = (np.column_stack([part[f"x{k}"], part[f"y{k}"]]) for k in (1, 2))
    return MatchSet(x1=x1, x2=x2, roll_deg=float(rolls[0]), **{name: part[name] for name in _PLAIN})
