"""The rows of the evaluation's tables, and the four tables themselves: a field is a column, named nowhere else."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Self, get_type_hints

import numpy as np
import pandas as pd

from epiprior.errors import EpipriorError

RANKS = tuple(sorted({*np.rint(10 ** (np.arange(41) / 10)).astype(int).tolist(), 500}))  # ten per decade, to 10,000
RANKINGS = ("lowe", "blogs", "2keypoint", "sfm", "final")  # of ranked inputs; others have `final` alone
CASCADE = "cascade"  # in the column `input` of timings and of pairs of kinds


class TableError(EpipriorError):
    """A table of results cannot be read or lacks a column; the message names the file."""


@dataclass(frozen=True, kw_only=True)
class Record:
    """What leads every row. `group` is a family, a split or a set; pair ids are unique within it."""

    group: str
    pair_id: str
    scene: str


@dataclass(frozen=True, kw_only=True)
class PairRecord(Record):
    """A pair and its ground truth.

    `labels` is what decides whether a match is right: ``depth``, ``plane`` (a homography), ``epipolar`` (the true F),
    ``control_points`` (an F fitted to them), empty where nothing does. Estimates are measured at `points`:
    ``control_points``, or points that the ``cameras`` allow. `right_share` is the share of right matches of X_L, by
    which `difficulty` is easy, medium or hard; NaN and empty without labels. `true_roll_deg`, in (-180, 180], is the
    roll between the cameras; `expected_roll_deg` the highest peak of its density over X_L and X_B; NaN where unknown.
    """

    features1: int
    features2: int
    labels: str
    points: str
    right_share: float
    difficulty: str
    true_roll_deg: float
    expected_roll_deg: float


@dataclass(frozen=True, kw_only=True)
class RunRecord(Record):
    """One estimator on one input of a pair, under one seed.

    From `status` to `iterations` as in `epiprior.types.FundamentalEstimate`; `matches` are what support is counted
    over. Errors are those of F whatever its status, NaN without F or where the truth does not allow them: mean and
    median over the control points of the Sampson distance; the normalised symmetric geometric `distance` to the true F;
    angles of the pose under the true calibration.
    """

    estimator: str
    input: str
    seed: int
    status: str
    support: int
    matches: int
    confidence: float
    geometry: str
    iterations: int | None
    error_px: float
    median_error_px: float
    distance: float
    rotation_deg: float
    translation_deg: float


@dataclass(frozen=True, kw_only=True)
class KindRecord(Record):
    """One estimator on one input of a pair of a `kind` (`epiprior_lab.evaluation.kinds`); fields as in `RunRecord`.

    `input` may also be `CASCADE`. `error_px`, at working size, is NaN but for true pairs with an F.
    """

    kind: str
    estimator: str
    input: str
    status: str
    geometry: str
    confidence: float
    support: int
    matches: int
    error_px: float


@dataclass(frozen=True, kw_only=True)
class RankingRecord(Record):
    """One ranking of one input of a labelled pair: the one-to-one list of its best roll hypothesis.

    `features1` and `features2` are the input's features in both images. `matches` is the length of the list, `right_at`
    the right ones among the first ``RANKS[i]``: columns ``right_<rank>``.
    """

    input: str
    ranking: str
    features1: int
    features2: int
    matches: int
    right: int
    average_precision: float
    right_at: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class CalibrationRecord(Record):
    """One bin of the probabilities of one ranked input: sums over the matches in it."""

    input: str
    bin: int
    count: int
    right: int
    probability: float
    squared_error: float


@dataclass(frozen=True, kw_only=True)
class TimingRecord(Record):
    """Wall time of one run from image files to F.

    `input` is as in `RunRecord`, or `CASCADE`: simple matches first, and ranked ones where these do not convince.
    Seconds are those of both images' features, from features to (ranked) matches, from matches to F, and of all.
    `preprocessed` is whether matches were ranked; for the cascade, whether it came to that.
    """

    estimator: str
    input: str
    seed: int
    seconds_features: float
    seconds_matching: float
    seconds_estimator: float
    seconds_total: float
    preprocessed: bool
    error_px: float


_DTYPES: dict[Any, str] = {str: "object", int: "int64", float: "float64", bool: "bool", int | None: "Int64"}


def column_types(record: type[Record]) -> dict[str, str]:
    """Return the columns of a record's table in order, with their pandas types."""
    hints = get_type_hints(record)
    last = [right_column(rank) for rank in RANKS] if hints.pop("right_at", None) else []
    return {name: _DTYPES[hint] for name, hint in hints.items()} | dict.fromkeys(last, "int64")


def right_column(rank: int) -> str:
    """Return the name of the column with the right matches among the first `rank`."""
    return f"right_{rank}"


def to_frame(record: type[Record], records: Iterable[Record]) -> pd.DataFrame:
    """Return records of one type as a table; without records, one without rows."""
    columns = column_types(record)
    rows = []
    for one in records:
        values = (getattr(one, f.name) for f in fields(one))
        rows.append([v for value in values for v in (value if isinstance(value, tuple) else (value,))])
    return pd.DataFrame(rows, columns=list(columns)).astype(columns)


def write_frame(table: pd.DataFrame, path: Path, *, digits: int = 7) -> None:
    """Write a CSV file: so many significant digits, empty cells for NaN."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format=f"%.{digits}g", lineterminator="\n")


def read_table(path: Path, columns: str, **how: Any) -> pd.DataFrame:
    """Read a CSV file that must have certain columns, separated by blanks; a TableError names what is missing.

    `how` is as for `pandas.read_csv`.
    """
    try:
        table: pd.DataFrame = pd.read_csv(path, **how)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise TableError(f"{path}: cannot be read as a table: {error}") from error
    missing = [name for name in columns.split() if name not in table.columns]
    if missing:
        raise TableError(f"{path}: no column {missing[0]!r}")
    return table


def read_frame(record: type[Record], path: Path) -> pd.DataFrame:
    """Read what `write_frame` wrote; names stay text, whatever they look like. TableError if it is no such table."""
    columns = column_types(record)
    numbers = {name: [""] for name, kind in columns.items() if kind in ("float64", "Int64")}
    return read_table(path, " ".join(columns), dtype=columns, na_values=numbers, keep_default_na=False)[list(columns)]


class TableSet:
    """Tables with one row per record; subclasses have a field, which is a CSV file, for each of `kinds`."""

    kinds: ClassVar[dict[str, type[Record]]]

    @classmethod
    def from_records(cls, records: Iterable[Record]) -> Self:
        """Sort records into their tables; within each they keep their order."""
        parts: dict[type[Record], list[Record]] = {record: [] for record in cls.kinds.values()}
        for one in records:
            parts[type(one)].append(one)
        return cls(**{name: to_frame(record, parts[record]) for name, record in cls.kinds.items()})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of all `parts`, in their order."""
        return cls(**{name: pd.concat([getattr(p, name) for p in parts], ignore_index=True) for name in cls.kinds})

    @classmethod
    def read(cls, folders: Sequence[Path]) -> Self:
        """Read what `write` wrote to each folder, one below the other; TableError names a bad file."""
        return cls.join([cls(**{n: read_frame(r, f / f"{n}.csv") for n, r in cls.kinds.items()}) for f in folders])

    def write(self, folder: Path) -> None:
        """Write the files to `folder`, made if absent."""
        for name in self.kinds:
            write_frame(getattr(self, name), folder / f"{name}.csv")


@dataclass(frozen=True, kw_only=True)
class Tables(TableSet):
    """The results of an evaluation."""

    kinds: ClassVar = {
        "pairs": PairRecord,
        "runs": RunRecord,
        "rankings": RankingRecord,
        "calibration": CalibrationRecord,
    }
    pairs: pd.DataFrame
    runs: pd.DataFrame
    rankings: pd.DataFrame
    calibration: pd.DataFrame
