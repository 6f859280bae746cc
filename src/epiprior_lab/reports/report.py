"""Everything that the report stage writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from epiprior_lab.params import ReportParams
from epiprior_lab.reports import figures
from epiprior_lab.reports.classifier_figure import classifier_figure
from epiprior_lab.reports.html import PageTables, write_page
from epiprior_lab.reports.study import Study
from epiprior_lab.reports.tables import (
    calibration_table,
    classifier_table,
    performance_markdown,
    performance_table,
    ranking_table,
    write_table,
)

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
        Thresholds and bootstrap.

    Returns
    -------
    list of Path
        What was written, tables first, the page last.
    """
    tables = PageTables(
        performance=performance_table(
            study,
            thresholds_px=(params.success_px, params.strict_px),
            draws=params.bootstrap_draws,
            seed=params.seed,
        ),
        rankings=ranking_table(study),
        calibration=calibration_table(study),
        classifiers=classifier_table(study),
        hand_over=study.hand_over,
    )
    written = [
        write_table(tables.performance, out / "performance.csv"),
        out / "performance.md",
        write_table(tables.rankings, out / "rankings.csv"),
        write_table(tables.calibration, out / "calibration.csv"),
        write_table(tables.classifiers, out / "classifiers.csv"),
        write_table(tables.hand_over, out / "hand_over.csv"),
    ]
    markdown = performance_markdown(tables.performance)
    (out / "performance.md").write_text(markdown, encoding="utf-8", newline="\n")
    at = out / "figures"
    drawn = {
        "performance": figures.performance_figure(tables.performance, params.success_px, at / "performance.png"),
        "successes": figures.success_figure(study, at / "successes.png"),
        "rankings": figures.ranking_figure(study, at / "rankings.png"),
        "roll": figures.roll_figure(study, at / "roll.png"),
        "calibration": figures.calibration_figure(study, at / "calibration.png"),
        "classifiers": classifier_figure(tables.classifiers, at / "classifiers.png"),
        "hand_over": figures.hand_over_figure(study, at / "hand_over.png"),
    }
    page = write_page(
        tables,
        {**drawn, **photographs},
        out / PAGE,
        success_px=params.success_px,
        strict_px=params.strict_px,
        seeds=study.results["seed"].nunique(),
    )
    return [*written, *drawn.values(), page]
