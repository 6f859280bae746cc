"""The rows of the analysis: a field is a column."""

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from epiprior_lab.evaluation.records import Record, TableSet

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


@dataclass(frozen=True, kw_only=True)
class Analysis(TableSet):
    """The tables of the analysis; `limits` holds groups analysed completely."""

    kinds: ClassVar = {"variants": VariantRecord, "precision": PrecisionRecord, "limits": LimitRecord}
    variants: pd.DataFrame
    precision: pd.DataFrame
    limits: pd.DataFrame
