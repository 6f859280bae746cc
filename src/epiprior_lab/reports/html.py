"""The page that holds everything: figures embedded, so that the file can be sent on its own; timings linked.

Timings differ from run to run. They are linked by a relative path and their numbers stay out of the page, so
that its bytes depend on the results only.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

import epiprior
from epiprior_lab.reports.classifier_figure import METRIC_NAMES, TARGET_NAMES
from epiprior_lab.reports.study import order_of
from epiprior_lab.reports.style import INPUT_LOOKS, RANKING_LOOKS
from epiprior_lab.reports.tables import ALL, COMPARISONS, contribution_cell

TIMING_FIGURE = "timings/overhead.png"
TIMING_TABLE = "timings/overhead.csv"


@dataclass(frozen=True, kw_only=True)
class PageTables:
    """The tables of the page, as made by `epiprior_lab.reports.tables`.

    Parameters
    ----------
    performance, rankings, calibration, classifiers : DataFrame
        As from the function of that name.
    hand_over : DataFrame
        The search; the page shows the chosen rows.
    """

    performance: pd.DataFrame
    rankings: pd.DataFrame
    calibration: pd.DataFrame
    classifiers: pd.DataFrame
    hand_over: pd.DataFrame


def write_page(
    tables: PageTables,
    figures: Mapping[str, Path],
    path: Path,
    *,
    success_px: float,
    strict_px: float,
    seeds: int,
) -> Path:
    """Write the page.

    Parameters
    ----------
    tables : PageTables
        Numbers.
    figures : mapping of str to Path
        PNG and JPEG files, by the names that the template uses: ``contact_sheet, example, performance,
        successes, rankings, roll, calibration, classifiers, hand_over``.
    path : Path
        HTML file.
    success_px, strict_px : float
        Thresholds of success, pixels.
    seeds : int
        Repetitions of each estimate.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("epiprior_lab.reports", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page = environment.get_template("page.html.j2").render(
        version=epiprior.__version__,
        images={name: _data_uri(file) for name, file in figures.items()},
        performance=[_performance_block(tables.performance, t) for t in (success_px, strict_px)],
        headline=_headline(tables.performance, success_px),
        rankings=_ranking_rows(tables.rankings),
        calibration=tables.calibration[tables.calibration["family"] == ALL].to_dict("records"),
        classifiers=_classifier_rows(tables.classifiers),
        hand_over=_hand_over_rows(tables.hand_over),
        success_px=success_px,
        strict_px=strict_px,
        seeds=seeds,
        timing_figure=TIMING_FIGURE,
        timing_table=TIMING_TABLE,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8", newline="\n")
    return path


def _data_uri(file: Path) -> str:
    """Return a figure as part of the page."""
    kind = {".png": "png", ".jpg": "jpeg"}[file.suffix]
    return f"data:image/{kind};base64," + base64.b64encode(file.read_bytes()).decode("ascii")


def _headline(table: pd.DataFrame, threshold_px: float) -> list[dict[str, Any]]:
    """Return, per family and input, the most successful pairs that any estimator reached, and which."""
    rows = []
    at = table[table["threshold_px"] == threshold_px]
    for family in order_of(at["family"]):
        records = at[at["family"] == family].to_dict("records")
        row: dict[str, Any] = {"family": "all families" if family == ALL else family}
        row["pairs"] = max(record["pairs"] for record in records)
        for name in INPUT_LOOKS:
            best = max(records, key=lambda record: record[name])
            row[name] = {"successes": f"{best[name]:.1f}", "estimator": best["estimator"]}
        rows.append(row)
    return rows


def _performance_block(table: pd.DataFrame, threshold_px: float) -> dict[str, Any]:
    at = table[table["threshold_px"] == threshold_px]
    inputs = [name for name in INPUT_LOOKS if name in table.columns]
    pairs = [(a, b) for a, b in COMPARISONS if f"{b}_over_{a}" in table.columns]
    groups = []
    for family in order_of(at["family"]):
        rows = []
        for row in at[at["family"] == family].to_dict("records"):
            best = max(round(row[name], 6) for name in inputs)
            cells = [{"text": f"{row[n]:.1f} ± {row[f'{n}_sd']:.1f}", "best": round(row[n], 6) == best} for n in inputs]
            changes = [contribution_cell(row, f"{b}_over_{a}") for a, b in pairs]
            rows.append({"estimator": row["estimator"], "cells": cells, "changes": changes})
        number = int(at.loc[at["family"] == family, "pairs"].max())
        groups.append({"family": "all families" if family == ALL else family, "pairs": number, "rows": rows})
    return {"threshold": threshold_px, "inputs": inputs, "comparisons": pairs, "groups": groups}


def _ranking_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    everything = table[table["family"] == ALL]
    return [
        row | {"name": RANKING_LOOKS[row["ranking"]].label if row["ranking"] in RANKING_LOOKS else row["ranking"]}
        for row in ({str(k): v for k, v in r.items()} for r in everything.to_dict("records"))
    ]


def _classifier_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    for (preset, target, family), part in table.groupby(["preset", "target", "family"], sort=False):
        values = part.set_index("metric")
        cells = {
            metric: (_number(values.loc[metric, "grouped"]), _number(values.loc[metric, "ungrouped"]))
            for metric in METRIC_NAMES
            if metric in values.index
        }
        rows.append(
            {
                "preset": preset,
                "target": TARGET_NAMES.get(str(target), target),
                "family": family,
                "metrics": {METRIC_NAMES[metric]: pair for metric, pair in cells.items()},
            }
        )
    return rows


def _hand_over_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    chosen = table[table["chosen"].astype(str).str.lower() == "true"]
    rows = []
    for row in chosen.to_dict("records"):
        cells = {str(name): _setting(value) for name, value in row.items()}
        cells["successes_10"] = f"{row['successes_10']:.1f} of {row['pairs']}"
        rows.append(cells)
    return rows


def _number(value: Any) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def _setting(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if pd.isna(value):
        return "–"
    return f"{value:g}" if isinstance(value, int | float) else str(value)
