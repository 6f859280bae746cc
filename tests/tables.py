"""Tables of matches, read back."""

import csv

import numpy as np

from epiprior.types import MatchSet

TYPES = dict.fromkeys(("set", "supporting_matrices", "feature1", "feature2"), np.int64)


def read_table(path):
    """Return the sets of a CSV or NPZ file, as `write_matches` was given them."""
    if path.suffix.lower() == ".npz":
        with np.load(path) as data:
            columns = dict(data)
    else:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
        cells = zip(*rows, strict=True) if rows else [()] * len(header)
        columns = {
            name: np.array([cell or "nan" for cell in column]).astype(TYPES.get(name, np.float64))
            for name, column in zip(header, cells, strict=True)
        }
    points = {f"x{k}": np.column_stack([columns.pop(f"x{k}"), columns.pop(f"y{k}")]) for k in (1, 2)}
    index, rolls = columns.pop("set"), columns.pop("roll_deg")
    sets = (points | columns).items()
    return tuple(
        MatchSet(roll_deg=float(rolls[index == i][0]), **{name: column[index == i] for name, column in sets})
        for i in np.unique(index)
    )
