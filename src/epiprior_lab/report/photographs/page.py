"""The committed page, and the gallery that stays here because it shows photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

import epiprior
from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.features.matching import INPUTS, WITHOUT
from epiprior_lab.params import ReportParams
from epiprior_lab.report.photographs.figures import MIN_BAR
from epiprior_lab.report.photographs.findings import (
    LIMITS_HEAD,
    ORIGIN,
    calibration_sentences,
    limits_rows,
    limits_sentence,
    pose_rows,
    pose_sentence,
    verdict_sentence,
)
from epiprior_lab.report.photographs.gallery import RESCUED, Case
from epiprior_lab.report.photographs.results import ALL
from epiprior_lab.report.photographs.tables import Tables
from epiprior_lab.report.photographs.wording import (
    RANKING_HEAD,
    RANKING_NOTE,
    SET_HEAD,
    bound_rows,
    group_title,
    input_name,
    named,
    number,
    ranking_rows,
    set_rows,
    share,
    success_head,
    success_rows,
)
from epiprior_lab.report.study import order_of
from epiprior_lab.report.verdicts import VERDICT_HEAD, verdict_rows

Block = dict[str, Any]


def write_page(
    tables: Tables, figures: Mapping[str, Path], cases: Sequence[Case], path: Path, *, params: ReportParams
) -> Path:
    """Write the page that is committed; its gallery shows lines and points on blank frames.

    Parameters
    ----------
    tables : Tables
        Numbers.
    figures : mapping of str to Path
        As from `figures.draw_figures`, in the page's folder or below.
    cases : sequence of Case
        Of the gallery, pictures in ``gallery/``.
    path : Path
        HTML file.
    params : ReportParams
        Thresholds.
    """
    page = (
        _environment()
        .get_template("page.html.j2")
        .render(
            version=epiprior.__version__,
            images={name: file.relative_to(path.parent).as_posix() for name, file in figures.items()},
            origin=ORIGIN,
            verdict_sentence=verdict_sentence(tables.successes, params.champion, params.success_px),
            bounds=bound_rows(tables.bounds),
            limits={
                "text": limits_sentence(tables.limits, params.champion, params.success_px),
                "head": LIMITS_HEAD,
                "rows": limits_rows(tables.limits),
            },
            poses=_pose_block(tables.geometry, params),
            sets={"head": SET_HEAD, "rows": set_rows(tables.sets)},
            successes=[_success_block(_of_all(tables.successes), threshold) for threshold in params.thresholds_px],
            by_set=_success_block(_of_sets(tables.successes), params.success_px),
            rankings={"head": RANKING_HEAD, "rows": ranking_rows(_of_all(tables.rankings)), "note": RANKING_NOTE},
            geometry=_geometry_block(tables.geometry, params),
            calibration=_calibration_block(tables.calibration),
            cascade=_cascade_block(tables.cascade, params.success_px),
            verdicts={"head": VERDICT_HEAD, "rows": verdict_rows(named(_of_all(tables.verdicts)))},
            estimators=[_estimator(row) for row in tables.estimators.to_dict("records")],
            cases=[_case(case, "gallery", "png") for case in cases],
            peers=[name for name in order_of(tables.successes["input"]) if name not in INPUTS],
            min_bar=MIN_BAR,
            params=params,
        )
    )
    path.write_text(page, encoding="utf-8", newline="\n")
    return path


def write_gallery(cases: Sequence[Case], path: Path) -> Path:
    """Write the gallery on photographs, beside its pictures; it may not be passed on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    page = _environment().get_template("gallery.html.j2")
    text = page.render(cases=[_case(case, ".", "jpg") for case in cases])
    path.write_text(text, encoding="utf-8", newline="\n")
    return path


def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("epiprior_lab.report.photographs", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def _estimator(row: Mapping[Any, Any]) -> list[str]:
    told = "" if np.isnan(row["hypotheses"]) else f"{row['hypotheses']:,.0f}"
    once = "once" if row["deterministic"] else "per seed"
    return [str(row["estimator"]), str(row["backend"]), f"{row['max_iterations']:,}", told, once]


def _success_block(successes: pd.DataFrame, threshold_px: float) -> Block:
    at = successes[successes["threshold_px"] == threshold_px]
    groups = []
    for group, part in at.groupby("group", sort=False):
        groups.append({"title": group_title(str(group), int(part["pairs"].iloc[0])), "rows": success_rows(part)})
    return {"threshold": threshold_px, "head": success_head(at), "groups": groups}


def _of_all(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of splits and of all: those of the sets are in the table beside the page."""
    return table[table["group"].isin((*SPLITS, ALL))]


def _of_sets(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the sets."""
    return table[~table["group"].isin((*SPLITS, ALL))]


def _geometry_block(geometry: pd.DataFrame, params: ReportParams) -> Block:
    """Return splits and all; the sets are in the table beside the page."""
    at = _of_all(geometry)
    areas = [f"auc_{limit:g}" for limit in params.pose_deg]
    groups = []
    for group, part in at.groupby("group", sort=False):
        rows = []
        for row in part.to_dict("records"):
            cells = [share(row.get(name, float("nan"))) for area in areas for name in (area, f"scene_{area}")]
            cells += [
                share(row.get("distance_recall", float("nan"))),
                number(row.get("median_distance", float("nan")), 4),
            ]
            rows.append([str(row["estimator"]), input_name(str(row["input"])), *cells])
        first = part.iloc[0]
        title = f"{group} pairs ({first['cameras']} with cameras, {first['true_F']} with a true F)"
        groups.append({"name": str(group), "title": title, "rows": rows})
    head = ["estimator", "input"]
    for limit in params.pose_deg:
        head += [f"pose, AUC {limit:g}°", "per scene"]
    return {"head": [*head, f"distance < {params.distance_recall:g}", "median distance"], "groups": groups}


def _pose_block(geometry: pd.DataFrame, params: ReportParams) -> Block:
    head, rows = pose_rows(geometry, params.pose_deg)
    marked = [[cell.replace("**", "") for cell in row] for row in rows]
    return {"text": pose_sentence(geometry, params.champion, params), "head": head, "rows": marked}


def _calibration_block(calibration: pd.DataFrame) -> Block:
    rows = [
        [str(row["group"]), str(row["matches"]), str(row["right"]), number(row["brier_score"], 4)]
        + [number(row["expected_calibration_error"], 4), share(row["lowest_share"]), number(row["upper_error"], 4)]
        for row in calibration.to_dict("records")
    ]
    head = ("group", "ranked matches", "right", "Brier score", "calibration error", "in lowest bin", "error of others")
    return {"head": head, "rows": rows, "text": calibration_sentences(calibration)}


def _cascade_block(cascade: pd.DataFrame, threshold_px: float) -> Block:
    at = cascade[cascade["threshold_px"] == threshold_px]
    groups = []
    for group in order_of(at["group"]):
        part = at[at["group"] == group]
        rows = [
            [str(row["estimator"]), *(f"{row[name]:.1f}" for name in ("without", "always", "cascade", "lost", "won"))]
            + [f"{row['change']:+.1f} [{row['change_low']:+.1f}, {row['change_high']:+.1f}]"]
            + [share(1 - row["preprocessed"])]
            for row in part.to_dict("records")
        ]
        title = group_title(group, int(part["pairs"].iloc[0]))
        groups.append({"name": group, "title": title, "rows": rows})
    head = ("estimator", "without", "always", "cascade", "lost", "won", "cascade over always", "runs skipped")
    return {"threshold": threshold_px, "head": head, "groups": groups}


def _case(case: Case, folder: str, suffix: str) -> Block:
    names = [input_name(name) for name in case.inputs]
    right = "unknown" if case.split == "unlabelled" else share(case.right_share)
    pictures = [
        {
            "src": f"{folder}/{case.name}-{name}.{suffix}",
            "alt": f"{case.pair_id}, {title}: best matches and epipolar lines",
            "title": f"{title}: {share(succeeded)} of the runs of {case.estimator} succeed; verdict on the one that "
            f"is drawn: {verdict}",
        }
        for name, title, succeeded, verdict in zip(case.inputs, names, case.succeeded, case.verdicts, strict=True)
    ]
    does = "rescue" if case.kind == RESCUED else "lose"
    against = "going without" if case.inputs[0] in WITHOUT else names[0]
    number = f"{case.changed} of {case.of} estimators {does} it against {against}"
    title = f"{case.set_name}, {case.pair_id} ({case.split}, right in X_L: {right}): {number}"
    return {"title": f"{case.kind}: {title}", "pictures": pictures}
