"""Everything that the report stage of the second pipeline writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.params import ReportParams
from epiprior_lab.report.cascade_tables import cascade_table
from epiprior_lab.report.markdown import markdown_table
from epiprior_lab.report.photographs.bounds import BoundParams, bounds_table, limits_table
from epiprior_lab.report.photographs.figures import draw_figures, enough_runs
from epiprior_lab.report.photographs.findings import (
    LIMITS_HEAD,
    ORIGIN,
    limits_rows,
    limits_sentence,
    pose_lines,
    pose_sentence,
    verdict_sentence,
)
from epiprior_lab.report.photographs.gallery import Case
from epiprior_lab.report.photographs.page import write_gallery, write_page
from epiprior_lab.report.photographs.results import ALL, Photographs
from epiprior_lab.report.photographs.tables import (
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
from epiprior_lab.report.photographs.wording import (
    RANKING_NOTE,
    SET_HEAD,
    bound_rows,
    group_title,
    named,
    ranking_lines,
    set_rows,
    split_lines,
    success_head,
    success_rows,
    wrapped,
)
from epiprior_lab.report.tables import estimator_table
from epiprior_lab.report.verdicts import verdict_figure, verdict_markdown
from epiprior_lab.selection.cascade_rule import paired_runs


def make_tables(photographs: Photographs, rule: CascadeRule, params: ReportParams) -> Tables:
    """Compute all tables but that of every pair."""
    draws, seed = params.bootstrap_draws, params.seed
    successes = success_table(photographs, thresholds_px=params.thresholds_px, draws=draws, seed=seed)
    rankings = ranking_table(photographs, draws=draws, seed=seed)
    bounds = bounds_table(
        photographs, successes, rankings, BoundParams(), success_px=params.success_px, draws=draws, seed=seed
    )
    return Tables(
        sets=set_table(photographs),
        bounds=bounds,
        limits=limits_table(photographs, params.champion, params.success_px),
        successes=successes,
        geometry=geometry_table(
            photographs, pose_deg=params.pose_deg, recall_at=params.distance_recall, success_px=params.success_px
        ),
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


def real_cascade_table(photographs: Photographs, rule: CascadeRule, params: ReportParams) -> pd.DataFrame:
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
    params: ReportParams,
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
    params : ReportParams
        Thresholds.
    gallery : Path
        Folder of the pictures on photographs, which stays here; its page is written too.
    """
    for name, table in vars(tables).items():
        write_real_table(table, out / "tables" / f"{name}.csv")
    write_real_table(pair_table(photographs), out / "tables" / "pairs.csv")
    text = report_markdown(tables, params)
    verdicts = tables.verdicts[tables.verdicts["group"].isin((*SPLITS, ALL))]
    text += "\n".join(["", *verdict_markdown(named(verdicts), params.success_px), ""])
    (out / "performance.md").write_text(text, encoding="utf-8", newline="\n")
    strict = min((t for t in params.thresholds_px if t >= 3), default=params.success_px)
    shown = dict.fromkeys((params.success_px, strict))
    figures = draw_figures(photographs, tables.successes, out / "figures", thresholds_px=list(shown))
    figures["verdicts"] = verdict_figure(enough_runs(verdicts), out / "figures" / "verdicts.png")
    write_page(tables, figures, cases, out / "index.html", params=params)
    write_gallery(cases, gallery / "index.html")


_TERMS = (
    "Successes are numbers of pairs whose error (mean over control points of the root of the Sampson distance) is "
    "below the threshold: mean over seeds ± one standard deviation. `without`: X_L of the paper, or all matches "
    "above a similarity for `generalized-ransac`. Contributions are (with - without) / without, with 95 % bootstrap "
    "intervals over scenes, where there is more than one. `per scene`: share of successes, averaged over scenes, "
    "without → ours, and its change in percentage points: pairs of one scene are alike, and some scenes have many. "
    "`ok only`: successes without → ours if only runs with the verdict `ok` count. Splits follow from the ground "
    "truth alone: the share of right matches in X_L is above 0.5 (easy), 0.2 to 0.5 (medium), below 0.2 (hard)."
)


def report_markdown(tables: Tables, params: ReportParams) -> str:
    """Return bounds and what limits them, sets, rankings and all successes as text for a reader."""
    successes, champion = tables.successes, params.champion
    at = successes[successes["threshold_px"] == params.success_px]
    split_rows = [] if at.empty else split_lines(successes, params.success_px)
    lines = [
        "# Photographs: estimators without and with the preprocessing step",
        "",
        *wrapped(ORIGIN),
        "",
        *wrapped(verdict_sentence(successes, champion, params.success_px)),
        "",
        *wrapped(_TERMS),
        "",
        "## Bounds",
        "",
        *markdown_table(
            ["bound", "found", "met"], [[r["bound"], r["found"], r["met"]] for r in bound_rows(tables.bounds)], texts=3
        ),
        "",
        "Times are measured apart, since they differ from run to run: timings/bounds.csv says what was wanted of them",
        "and whether it is met, timings/overhead.csv has them by estimator.",
        "",
        "### What limits the results",
        "",
        *wrapped(limits_sentence(tables.limits, champion, params.success_px)),
        "",
        *markdown_table(LIMITS_HEAD, limits_rows(tables.limits)),
        "",
        f"### All splits, below {params.success_px:g} px",
        "",
        *split_rows,
        "",
        "## Sets",
        "",
        *markdown_table(SET_HEAD, set_rows(tables.sets)),
        "",
        "`epipolar`: only the epipolar line decides whether a match is right, and 1 to 4 % of random matches satisfy",
        "that by chance; `3D` and `plane` would be exact. `none`: the control points decide no F, so nothing is",
        "labelled, and the pair is in no split.",
        "",
        "## Rankings",
        "",
        *RANKING_NOTE,
        "",
        *ranking_lines(tables.rankings),
        "",
        "## Poses",
        "",
        *wrapped(pose_sentence(tables.geometry, champion, params)),
        "",
        *pose_lines(tables.geometry, params.pose_deg),
    ]
    for threshold, at in successes.groupby("threshold_px", sort=False):
        lines += ["", f"## Below {threshold:g} px"]
        first = threshold == successes["threshold_px"].iloc[0]
        lines += [] if first else ["", "By set: tables/successes.csv."]  # they would be hundreds of lines more
        shown = at if first else at[at["group"].isin((*SPLITS, ALL))]
        for group, part in shown.groupby("group", sort=False):
            title = group_title(str(group), int(part["pairs"].iloc[0]))
            lines += ["", f"### {title}", "", *markdown_table(success_head(part), success_rows(part))]
    return "\n".join(lines) + "\n"
