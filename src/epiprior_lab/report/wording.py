"""Numbers of the tables as a reader sees them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.report.bounds import CONTRIBUTION, EASY
from epiprior_lab.report.performance import ALL

INPUT_TITLES = {"default": "our ranked matches", "snn": "snn matches"}


def family_title(family: str) -> str:
    """Return the name of a family, or of all of them."""
    return "all families" if family == ALL else family


def percent(value: float) -> str:
    """Return a share as a signed percentage: ``+45 %``, or ``new`` where nothing succeeded without."""
    if np.isinf(value):
        return "new"
    return f"{100 * value:+.0f} %" if round(100 * value) else "0 %"


def contribution_cell(row: Mapping[Any, Any], name: str) -> str:
    """Return ``+45 % [+12 %, +90 %]`` of the columns `name`, `name`_low and `name`_high.

    Empty without numbers; without brackets where there is no interval.
    """
    if np.isnan(row[name]):
        return ""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    return percent(row[name]) + ("" if np.isnan(low) else f" [{percent(low)}, {percent(high)}]")


def difference_cell(row: Mapping[Any, Any], name: str = "difference") -> str:
    """Return ``+2.4 [+0.6, +4.4]``, pairs."""
    # Adding 0.0 turns -0.0 into 0.0.
    middle, low, high = (round(row[f"{name}{end}"], 1) + 0.0 for end in ("", "_low", "_high"))
    return f"{middle:+.1f} [{low:+.1f}, {high:+.1f}]"


def success_cell(row: Mapping[Any, Any], name: str) -> str:
    """Return ``15.8 ± 0.4``, pairs; empty where an estimator did not get the input."""
    return "" if np.isnan(row[name]) else f"{row[name]:.1f} ± {row[f'{name}_sd']:.1f}"


def bound_rows(table: pd.DataFrame, champion: str) -> list[dict[str, str]]:
    """Return each bound in words.

    Parameters
    ----------
    table : DataFrame
        As from `bounds.bounds_table`.
    champion : str
        The estimator that the duels are about.

    Returns
    -------
    list of dict
        ``bound, found, met`` (``yes`` or ``no``).
    """
    return [
        {"bound": _bound(row, champion), "found": _found(row), "met": "yes" if row["met"] else "no"}
        for row in table.to_dict("records")
    ]


def _bound(row: Mapping[Any, Any], champion: str) -> str:
    family, threshold = row["family"], f"{row['threshold_px']:g} px"
    if row["kind"] == CONTRIBUTION:
        return f"{row['estimator']} gains at least {percent(row['wanted'])} on {family}, {threshold}"
    if row["kind"] == EASY:
        return f"no estimator loses more than {-100 * row['wanted']:g} % on {family}, {threshold}"
    return f"{champion} beats every other estimator on {INPUT_TITLES[row['input']]}, {family}, {threshold}"


def _found(row: Mapping[Any, Any]) -> str:
    if row["kind"] == CONTRIBUTION:
        limit = "" if np.isinf(row["possible"]) else f"; {percent(row['possible'])} if it solved every pair"
        interval = {"found": row["found"], "found_low": row["low"], "found_high": row["high"]}
        return contribution_cell(interval, "found") + limit
    if row["kind"] == EASY:
        kept = f"{row['beaten']:.0f} of {row['others']:.0f} keep to it"
        return f"{kept}; {row['estimator']} comes out lowest: {percent(row['found'])}"
    interval = {"found": row["found"], "found_low": row["low"], "found_high": row["high"]}
    ahead = f"{row['beaten']:.0f} of {row['others']:.0f} beaten"
    closest = f"closest is {row['estimator']}: {difference_cell(interval, 'found')} pairs"
    return f"{ahead}; {closest}, at most {row['possible']:+.1f} if it solved every pair"
