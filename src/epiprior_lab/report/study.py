"""What the stages left behind, as the report reads it: data frames with checked columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.errors import EpipriorError
from epiprior.types import FloatArray

COLUMNS = {
    "results": "family pair_id scene estimator input seed status support iterations error_px median_error_px",
    "rankings": "family pair_id scene preset ranking matches right precision_10 precision_100 precision_500 "
    "average_precision",
    "ranking_curves": "family pair_id scene preset ranking rank right",
    "roll": "family pair_id scene true_roll_deg expected_roll_deg angle_deg density",
    "calibration": "family pair_id scene preset bin count right probability squared_error",
    "hand_over": "estimator input step one_to_one top_k min_probability max_distance_ratio spread "
    "threshold_px collect refine pairs successes_10 successes_3 area chosen",
    "classifiers": "target family grouped fold metric value",
}


class ReportError(EpipriorError):
    """A table of results cannot be read or lacks a column; the message names the file."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Results of the whole study.

    Parameters
    ----------
    results, rankings, ranking_curves, roll, calibration : DataFrame
        Of all families, in their order; columns as in `COLUMNS`.
    hand_over : DataFrame
        The search on validation scenes.
    classifiers : DataFrame
        Cross-validation of the classifiers, with a column ``preset`` in front.
    families : tuple of str
        Families of test pairs, in the order of the report.
    """

    results: pd.DataFrame
    rankings: pd.DataFrame
    ranking_curves: pd.DataFrame
    roll: pd.DataFrame
    calibration: pd.DataFrame
    hand_over: pd.DataFrame
    classifiers: pd.DataFrame
    families: tuple[str, ...]

    @classmethod
    def read(cls, data: Path, hand_over: Path, *, families: Sequence[str], presets: Sequence[str]) -> Study:
        """Read everything.

        Parameters
        ----------
        data : Path
            Folder with ``evaluation/<family>/*.csv`` and ``training/<preset>/metrics.csv``.
        hand_over : Path
            CSV file of the search.
        families, presets : sequence of str
            What was studied.

        Raises
        ------
        ReportError
            If a file is missing or lacks a column.
        """

        def evaluation(name: str) -> pd.DataFrame:
            parts = [read_table(data / "evaluation" / f / f"{name}.csv", COLUMNS[name]) for f in families]
            return pd.concat(parts, ignore_index=True)

        metrics = []
        for preset in presets:
            table = read_table(data / "training" / preset / "metrics.csv", COLUMNS["classifiers"])
            table.insert(0, "preset", preset)
            metrics.append(table)
        return cls(
            results=evaluation("results"),
            rankings=evaluation("rankings"),
            ranking_curves=evaluation("ranking_curves"),
            roll=evaluation("roll"),
            calibration=evaluation("calibration"),
            hand_over=read_table(hand_over, COLUMNS["hand_over"]),
            classifiers=pd.concat(metrics, ignore_index=True),
            families=tuple(families),
        )


def read_table(path: Path, columns: str) -> pd.DataFrame:
    """Read a CSV file that must have certain columns, separated by blanks in `columns`.

    Raises
    ------
    ReportError
        If it cannot be read or lacks one; the message names the file and the column.
    """
    try:
        table = pd.read_csv(path, keep_default_na=True)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ReportError(f"{path}: cannot be read as a table: {error}") from error
    missing = [name for name in columns.split() if name not in table.columns]
    if missing:
        raise ReportError(f"{path}: no column {missing[0]!r}")
    return table


def errors_of(results: pd.DataFrame, **where: Any) -> pd.DataFrame:
    """Return errors for the rows that agree with `where`, one row per pair, one column per seed.

    Rows are ordered by pair id. A run without F has an infinite error; what the verdict says of an F changes nothing.
    """
    rows = results
    for column, value in where.items():
        rows = rows[rows[column] == value]
    errors = rows["error_px"].fillna(np.inf)
    return rows.assign(error_px=errors).pivot_table(
        index=["pair_id", "scene"], columns="seed", values="error_px", sort=True, aggfunc="first"
    )


def success_rates(results: pd.DataFrame, threshold_px: float, **where: Any) -> tuple[FloatArray, list[str]]:
    """Return the share of seeds below the threshold for each pair, and the pairs' scenes, by pair id."""
    errors = errors_of(results, **where)
    rates = (errors.to_numpy() < threshold_px).mean(axis=1)
    return rates, [str(scene) for scene in errors.index.get_level_values("scene")]


def order_of(values: pd.Series[Any]) -> list[str]:
    """Return the different values of a column in the order in which they first appear."""
    return [str(value) for value in values.unique()]
