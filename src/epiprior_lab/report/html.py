"""The page that holds everything; pictures, and tables of other stages, lie beside it and are linked.

Timings differ from run to run. Their numbers stay out of the page, so that its bytes depend on the results only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

import epiprior
from epiprior_lab.report.classifier_figure import METRIC_NAMES, TARGET_NAMES
from epiprior_lab.report.performance import ALL, COLUMNS, COMPARISONS
from epiprior_lab.report.study import order_of
from epiprior_lab.report.style import RANKING_LOOKS
from epiprior_lab.report.tables import ENOUGH_RIGHT, STATED
from epiprior_lab.report.verdicts import VERDICT_HEAD, verdict_rows
from epiprior_lab.report.wording import bound_rows, contribution_cell, difference_cell, family_title, success_cell

# What other stages write; these names are theirs.
TIMING_FIGURES = {"overhead": "timings/overhead.png", "estimators": "timings/estimators.png"}
TIMING_TABLES = ("timings/overhead.csv", "timings/estimators.csv", "timings/pairs.csv")


@dataclass(frozen=True, kw_only=True)
class PageTables:
    """The tables of the page, as made by `epiprior_lab.report.tables`.

    Parameters
    ----------
    performance, duels, bounds, rankings, calibration, classifiers, estimators : DataFrame
        As from the function of that name, such as `performance.performance_table`.
    hand_over : DataFrame
        The search; the page shows the chosen rows.
    verdicts : DataFrame
        As from `verdicts.study_verdicts`.
    """

    performance: pd.DataFrame
    duels: pd.DataFrame
    bounds: pd.DataFrame
    rankings: pd.DataFrame
    calibration: pd.DataFrame
    classifiers: pd.DataFrame
    estimators: pd.DataFrame
    hand_over: pd.DataFrame
    verdicts: pd.DataFrame


def write_page(
    tables: PageTables,
    figures: Mapping[str, Path],
    path: Path,
    *,
    success_px: float,
    strict_px: float,
    seeds: int,
    champion: str,
) -> Path:
    """Write the page.

    Parameters
    ----------
    tables : PageTables
        Numbers.
    figures : mapping of str to Path
        PNG and JPEG files in the page's folder or below, by the names that the template uses: ``contact_sheet,
        example, performance, successes, duels, rankings, roll, calibration, classifiers, hand_over,
        verdicts``.
    path : Path
        HTML file.
    success_px, strict_px : float
        Thresholds of success, pixels.
    seeds : int
        Repetitions of each estimate.
    champion : str
        The estimator of the duels.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("epiprior_lab.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page = environment.get_template("page.html.j2").render(
        version=epiprior.__version__,
        images={name: file.relative_to(path.parent).as_posix() for name, file in figures.items()},
        performance=[_performance_block(tables.performance, t) for t in (success_px, strict_px)],
        headline=_headline(tables.performance, success_px),
        bounds=bound_rows(tables.bounds, champion),
        duels=[_duel_block(tables.duels, t) for t in (success_px, strict_px)],
        champion=champion,
        estimators=tables.estimators.to_dict("records"),
        rankings=_ranking_rows(tables.rankings),
        calibration=tables.calibration[tables.calibration["family"] == ALL].to_dict("records"),
        classifiers=_classifier_rows(tables.classifiers),
        hand_over=_hand_over_rows(tables.hand_over),
        verdicts={"head": VERDICT_HEAD, "rows": verdict_rows(tables.verdicts)},
        success_px=success_px,
        strict_px=strict_px,
        seeds=seeds,
        timing_figures=TIMING_FIGURES,
        timing_tables=TIMING_TABLES,
        enough=ENOUGH_RIGHT,
        stated=f"{STATED:g}",
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8", newline="\n")
    return path


def _headline(table: pd.DataFrame, threshold_px: float) -> list[dict[str, Any]]:
    """Return, per family and input, the most successful pairs that any estimator reached, and which."""
    rows = []
    at = table[table["threshold_px"] == threshold_px]
    for family in order_of(at["family"]):
        records = at[at["family"] == family].to_dict("records")
        row: dict[str, Any] = {"family": family_title(family), "pairs": records[0]["pairs"]}
        for name in COLUMNS:
            given = [record for record in records if np.isfinite(record[name])]
            best = max(given, key=lambda record: record[name], default=None)
            text = ("–", "") if best is None else (f"{best[name]:.1f}", best["estimator"])
            row[name] = {"successes": text[0], "estimator": text[1]}
        rows.append(row)
    return rows


def _performance_block(table: pd.DataFrame, threshold_px: float) -> dict[str, Any]:
    at = table[table["threshold_px"] == threshold_px]
    groups = []
    for family in order_of(at["family"]):
        rows = []
        for row in at[at["family"] == family].to_dict("records"):
            best = np.nanmax([round(row[name], 6) for name in COLUMNS])
            cells = [{"text": success_cell(row, name), "best": round(row[name], 6) == best} for name in COLUMNS]
            changes = [contribution_cell(row, f"{b}_over_{a}") for a, b in COMPARISONS]
            rows.append({"estimator": row["estimator"], "cells": cells, "changes": changes})
        number = int(at.loc[at["family"] == family, "pairs"].max())
        groups.append({"family": family_title(family), "pairs": number, "rows": rows})
    return {"threshold": threshold_px, "inputs": COLUMNS, "comparisons": COMPARISONS, "groups": groups}


def _duel_block(table: pd.DataFrame, threshold_px: float) -> dict[str, Any]:
    """Return one row per other estimator, one cell per family and input."""
    at = table[table["threshold_px"] == threshold_px]
    families, inputs = order_of(at["family"]), order_of(at["input"])
    records = at.set_index(["estimator", "family", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        found = [records[estimator, family, name] for family in families for name in inputs]
        cells = [{"text": difference_cell(row), "verdict": row["verdict"]} for row in found]
        rows.append({"estimator": estimator, "cells": cells})
    return {"threshold": threshold_px, "families": [family_title(f) for f in families], "inputs": inputs, "rows": rows}


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
