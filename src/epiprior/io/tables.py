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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
