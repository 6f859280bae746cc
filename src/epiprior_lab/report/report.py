"""Everything that the report stage writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from epiprior_lab.params import ReportParams
from epiprior_lab.report import figures, success_figures
from epiprior_lab.report.bounds import BoundParams, bounds_table
from epiprior_lab.report.classifier_figure import classifier_figure
from epiprior_lab.report.hand_over_figure import hand_over_figure
from epiprior_lab.report.html import PageTables, write_page
from epiprior_lab.report.markdown import performance_markdown
from epiprior_lab.report.performance import duel_table, performance_table
from epiprior_lab.report.study import Study, order_of
from epiprior_lab.report.tables import (
    calibration_table,
    classifier_table,
    estimator_table,
    ranking_table,
    write_table,
)
from epiprior_lab.report.verdicts import study_verdicts, verdict_figure, verdict_markdown

PAGE = "index.html"


def write_report(study: Study, photographs: Mapping[str, Path], out: Path, params: ReportParams) -> list[Path]:
    """Write tables, figures and the page.

    Parameters
    ----------
    study : Study
        Results.
    photographs : mapping of str to Path
        Pictures of the scenes that the page shows: ``contact_sheet`` and ``example``.
    out : Path
        Folder; ``index.html``, ``performance.csv`` and ``.md``, further tables, and ``figures/``.
    params : ReportParams
        Thresholds, bootstrap and bounds.

    Returns
    -------
    list of Path
        What was written, tables first, the page last.
    """
    tables = _tables(study, params)
    written = [
        write_table(tables.performance, out / "performance.csv"),
        write_table(tables.duels, out / "duel.csv"),
        write_table(tables.bounds, out / "bounds.csv"),
        write_table(tables.estimators, out / "estimators.csv"),
        write_table(tables.rankings, out / "rankings.csv"),
        write_table(tables.calibration, out / "calibration.csv"),
        write_table(tables.classifiers, out / "classifiers.csv"),
        write_table(tables.hand_over, out / "hand_over.csv"),
        write_table(tables.verdicts, out / "verdicts.csv"),
        out / "performance.md",
    ]
    champion = params.champion
    markdown = performance_markdown(tables.performance, tables.duels, tables.bounds, champion)
    verdicts = "\n".join(["", *verdict_markdown(tables.verdicts, params.success_px), ""])
    (out / "performance.md").write_text(markdown + verdicts, encoding="utf-8", newline="\n")
    drawn = _figures(study, tables, out / "figures", params)
    page = write_page(
        tables,
        {**drawn, **photographs},
        out / PAGE,
        success_px=params.success_px,
        strict_px=params.strict_px,
        seeds=study.results["seed"].nunique(),
        champion=champion,
    )
    return [*written, *drawn.values(), page]


def _tables(study: Study, params: ReportParams) -> PageTables:
    thresholds = (params.success_px, params.strict_px)
    draws, seed = params.bootstrap_draws, params.seed
    performance = performance_table(study, thresholds_px=thresholds, draws=draws, seed=seed)
    duels = duel_table(study, params.champion, thresholds_px=thresholds, draws=draws, seed=seed)
    return PageTables(
        performance=performance,
        duels=duels,
        bounds=bounds_table(performance, duels, BoundParams(), success_px=params.success_px, thresholds_px=thresholds),
        rankings=ranking_table(study),
        calibration=calibration_table(study),
        classifiers=classifier_table(study),
        estimators=estimator_table(order_of(study.results["estimator"])),
        hand_over=study.hand_over,
        verdicts=study_verdicts(study, params.success_px),
    )


def _figures(study: Study, tables: PageTables, at: Path, params: ReportParams) -> dict[str, Path]:
    return {
        "performance": success_figures.performance_figure(tables.performance, at / "performance.png"),
        "successes": success_figures.success_figure(study, at / "successes.png"),
        "duels": success_figures.duel_figure(tables.duels, params.champion, params.hard_groups, at / "duels.png"),
        "rankings": figures.ranking_figure(study, at / "rankings.png"),
        "roll": figures.roll_figure(study, at / "roll.png"),
        "calibration": figures.calibration_figure(study, at / "calibration.png"),
        "classifiers": classifier_figure(tables.classifiers, at / "classifiers.png"),
        "hand_over": hand_over_figure(study, at / "hand_over.png"),
        "verdicts": verdict_figure(tables.verdicts, at / "verdicts.png"),
    }
