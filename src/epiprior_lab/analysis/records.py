"""The rows of the analysis: a field is a column."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import pandas as pd

from epiprior_lab.evaluation.records import Record, read_frame, to_frame, write_frame

NO_ESTIMATOR = "none"  # in the column `estimator`: a matrix that no estimator chose


@dataclass(frozen=True, kw_only=True)
class VariantRecord(Record):
    """One estimate of one variant of the method.

    `experiment` is ``steps``, ``ablation`` or ``oracle``, see `epiprior_lab.analysis.analyse`; `variant` is what was
    replaced, `ranking` by what matches were ordered, `estimator` what ran on them. `error_px` is the mean Sampson
    distance of the control points, whatever the status, NaN without F; `score` the support of F among the one-to-one
    matches of the preset `default`, weighted by their probabilities.
    """

    experiment: str
    variant: str
    ranking: str
    estimator: str
    seed: int
    status: str
    error_px: float
    score: float


@dataclass(frozen=True, kw_only=True)
class PrecisionRecord(Record):
    """One ranking of one variant, one-to-one, under the expected roll."""

    variant: str
    ranking: str
    matches: int
    right: int
    precision_10: float
    precision_100: float
    average_precision: float


@dataclass(frozen=True, kw_only=True)
class LimitRecord(Record):
    """What the matches and hypotheses of a pair allow: numbers of the better roll hypothesis, sums for matrices."""

    matches: int
    right_one_to_one: int
    right_one_to_one_in_x: int
    rough_matrices: int
    good_rough_matrices: int


RECORDS: dict[str, type[Record]] = {"variants": VariantRecord, "precision": PrecisionRecord, "limits": LimitRecord}


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """The tables of the analysis; each field is a CSV file of its name. `limits` holds groups analysed completely."""

    variants: pd.DataFrame
    precision: pd.DataFrame
    limits: pd.DataFrame

    @classmethod
    def from_records(cls, records: Iterable[Record]) -> Self:
        """Sort records into their tables; within each they keep their order."""
        found = list(records)
        return cls(**{n: to_frame(kind, (r for r in found if isinstance(r, kind))) for n, kind in RECORDS.items()})

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read what `write` wrote; a missing file or column is a TableError that names it."""
        return cls(**{name: read_frame(kind, folder / f"{name}.csv") for name, kind in RECORDS.items()})

    def write(self, folder: Path) -> None:
        """Write the files to `folder`, made if absent."""
        for name in RECORDS:
            write_frame(getattr(self, name), folder / f"{name}.csv")
