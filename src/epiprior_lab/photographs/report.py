"""Everything that the report stage of the second pipeline writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from epiprior.cascade import CascadeRule
from epiprior_lab.cascade_rule import paired_runs
from epiprior_lab.photographs.bounds import bounds_table
from epiprior_lab.photographs.figures import draw_figures
from epiprior_lab.photographs.gallery import Case
from epiprior_lab.photographs.page import write_gallery, write_page
from epiprior_lab.photographs.params import RealReportParams
from epiprior_lab.photographs.results import ALL, Photographs
from epiprior_lab.photographs.tables import (
    Tables,
    calibration_table,
    geometry_table,
    group_verdicts,
    pair_table,
    ranking_table,
    set_table,
    success_table,
    write_real_table,
)
from epiprior_lab.photographs.truth import SPLITS
from epiprior_lab.photographs.wording import named, report_markdown
from epiprior_lab.reports.cascade_tables import cascade_table
from epiprior_lab.reports.tables import estimator_table
from epiprior_lab.reports.verdicts import verdict_figure, verdict_markdown


def make_tables(photographs: Photographs, rule: CascadeRule, params: RealReportParams) -> Tables:
    """Compute all tables but that of every pair."""
    draws, seed = params.bootstrap_draws, params.seed
    successes = success_table(photographs, thresholds_px=params.thresholds_px, draws=draws, seed=seed)
    rankings = ranking_table(photographs, draws=draws, seed=seed)
    bounds = bounds_table(
        photographs, successes, rankings, params.bounds, success_px=params.success_px, draws=draws, seed=seed
    )
    return Tables(
        sets=set_table(photographs),
        bounds=bounds,
        successes=successes,
        geometry=geometry_table(photographs, pose_deg=params.pose_deg, recall_at=params.distance_recall),
        rankings=rankings,
        calibration=calibration_table(photographs),
        cascade=real_cascade_table(photographs, rule, params),
        estimators=_estimators(photographs),
        verdicts=group_verdicts(photographs, params.success_px),
    )


def _estimators(photographs: Photographs) -> pd.DataFrame:
    """Return what stands behind each name, and ``hypotheses``, the median over its runs where its backend tells."""
    counts = photographs.results.groupby("estimator")["iterations"].median()
    table = estimator_table(photographs.estimators)
    return table.assign(hypotheses=counts.reindex(table["estimator"]).to_numpy(np.float64))


def real_cascade_table(photographs: Photographs, rule: CascadeRule, params: RealReportParams) -> pd.DataFrame:
    """Return what the rule that was learnt on rendered scenes does on photographs, by split and over all.

    Nothing is run again: a cascade takes one run or the other of the same pair and seed.
    """
    table = photographs.results[photographs.results["pair"].isin(photographs.counted)]
    groups = pd.Categorical(table["split"], [*SPLITS, *sorted(set(table["split"]) - set(SPLITS))])
    table = table.assign(family=table["split"], pair_id=table["pair"], order=groups).sort_values("order", kind="stable")
    runs = {"photographs": paired_runs(table)}
    thresholds = [threshold for threshold in params.thresholds_px if threshold >= 3]
    found = cascade_table(runs, rule, thresholds_px=thresholds, draws=params.bootstrap_draws, seed=params.seed)
    return found.drop(columns="split").rename(columns={"family": "group"})


def write_report(
    photographs: Photographs,
    tables: Tables,
    cases: Sequence[Case],
    out: Path,
    params: RealReportParams,
    *,
    gallery: Path,
) -> None:
    """Write tables, figures and pages.

    Parameters
    ----------
    photographs, tables
        Results, and what `make_tables` made of them.
    cases : sequence of Case
        Of the gallery; their pictures are drawn already.
    out : Path
        Folder: ``index.html``, ``performance.md``, ``tables/``, ``figures/``; pictures on blank frames lie in
        ``gallery/``.
    params : RealReportParams
        Thresholds.
    gallery : Path
        Folder of the pictures on photographs, which stays here; its page is written too.
    """
    for name, table in vars(tables).items():
        write_real_table(table, out / "tables" / f"{name}.csv")
    write_real_table(pair_table(photographs), out / "tables" / "pairs.csv")
    text = report_markdown(tables.bounds, tables.sets, tables.successes, tables.rankings)
    verdicts = tables.verdicts[tables.verdicts["group"].isin((*SPLITS, ALL))]
    text += "\n".join(["", *verdict_markdown(named(verdicts), params.success_px), ""])
    (out / "performance.md").write_text(text, encoding="utf-8", newline="\n")
    strict = min((t for t in params.thresholds_px if t >= 3), default=params.success_px)
    shown = dict.fromkeys((params.success_px, strict))
    figures = draw_figures(photographs, tables.successes, out / "figures", thresholds_px=list(shown))
    figures["verdicts"] = verdict_figure(verdicts, out / "figures" / "verdicts.png")
    write_page(tables, figures, cases, out / "index.html", params=params)
    write_gallery(cases, gallery / "index.html", estimator=params.gallery.estimator)
