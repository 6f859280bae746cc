"""A report: tables as CSV, figures, and one page as Markdown and HTML. Study, photographs and any folder are calls of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.params import ReportParams
from epiprior_lab.report import figures, tables
from epiprior_lab.report.bounds import Bound, judge
from epiprior_lab.report.cascade import cascade_table
from epiprior_lab.report.gallery import Case, write_gallery
from epiprior_lab.report.page import Block, Page
from epiprior_lab.report.results import Results, read_table
from epiprior_lab.report.sections import Material, all_sections
from epiprior_lab.report.text import ALL, DIFFICULTIES, OURS

CLASSIFIER_COLUMNS = "target family grouped fold metric value"
HAND_OVER_COLUMNS = "estimator input step top_k one_to_one threshold_px pairs successes_10 successes_3 area chosen"


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a report is made of beside the results.

    Parameters
    ----------
    title, about, origin : str
        Of the page; where the pairs come from.
    rule : CascadeRule, optional
        Of the cascade.
    bounds : sequence of Bound
        What was wanted.
    known_sets : sequence of KnownSet
        Sets that are listed even where they are not present.
    classifiers, hand_over : DataFrame, optional
        Cross-validation (`read_classifiers`) and the search on validation scenes.
    pictures : mapping of str to Path
        Made before: ``contact_sheet``, ``example``, ``roll``, ``cascade``.
    cases : sequence of Case
        Of the gallery; their pictures are drawn already.
    gallery : Path, optional
        Folder of those on photographs, which stays here; its page is written too.
    links : mapping of str to blocks
        See `Material`.
    """

    title: str
    about: str
    origin: str
    rule: CascadeRule | None = None
    bounds: Sequence[Bound] = ()
    known_sets: Sequence[object] = ()
    classifiers: pd.DataFrame | None = None
    hand_over: pd.DataFrame | None = None
    pictures: Mapping[str, Path] = field(default_factory=dict)
    cases: Sequence[Case] = ()
    gallery: Path | None = None
    links: Mapping[str, Sequence[Block]] = field(default_factory=dict)


def read_results(evaluated: Tables, params: ReportParams, *, apart: Sequence[str] = ()) -> Results:
    """Return results by group, or by difficulty where the hard groups of the parameters are difficulties."""
    by = "difficulty" if set(params.hard_groups) <= set(DIFFICULTIES) else "group"
    how = {"draws": params.bootstrap_draws, "seed": params.seed}
    return Results(evaluated, by=by, hard=params.hard_groups, apart=apart, **how)


def make_tables(results: Results, report: Report, params: ReportParams) -> dict[str, pd.DataFrame]:
    """Return all tables by the names of their files, those without rows left out."""
    thresholds = (params.success_px, params.strict_px)
    ranked = all(OURS in results.inputs(estimator) for estimator in results.estimators)
    made = {
        "successes": tables.success_table(results, params.thresholds_px),
        "duels": tables.duel_table(results, params.champion, dict.fromkeys(thresholds)),
        "geometry": tables.geometry_table(
            results, pose_deg=params.pose_deg, recall_at=params.distance_recall, success_px=params.success_px
        ),
        "rankings": tables.ranking_table(results),
        "calibration": tables.calibration_table(results),
        "statuses": tables.status_table(results, params.success_px),
        "sets": tables.set_table(results, report.known_sets),
        "estimators": tables.estimator_table(results),
        "limits": tables.limits_table(results, params.champion, params.success_px),
        "pairs": tables.pair_table(results),
    }
    if report.rule is not None and ranked:
        made["cascade"] = cascade_table(results, report.rule, thresholds)
    if report.classifiers is not None:
        made["classifiers"] = tables.classifier_table(report.classifiers)
    if report.hand_over is not None:
        made["hand_over"] = report.hand_over
    made["bounds"] = judge(list(report.bounds), results=results, tables=made)
    return {name: table for name, table in made.items() if len(table)}


def draw_figures(
    results: Results, made: Mapping[str, pd.DataFrame], params: ReportParams, folder: Path
) -> dict[str, Path]:
    """Draw what the tables allow, and return the files by their names."""
    groups = [group for group, _ in results.groups(results.main[:-1] or (ALL,))]
    groups = groups or [ALL]
    thresholds = list(dict.fromkeys((params.success_px, params.strict_px)))
    draw: dict[str, Callable[[Path], None]] = {
        "successes": lambda path: figures.success_figure(made["successes"], groups, thresholds, path),
        "curves": lambda path: figures.curve_figure(results, path),
        "duels": lambda path: figures.duel_figure(made["duels"], params.champion, results.hard or (ALL,), path),
        "rankings": lambda path: figures.ranking_figure(results, path),
        "calibration": lambda path: figures.calibration_figure(results, path),
        "statuses": lambda path: figures.status_figure(made["statuses"], [*groups, ALL], path),
        "classifiers": lambda path: figures.classifier_figure(made["classifiers"], path),
        "hand_over": lambda path: figures.hand_over_figure(made["hand_over"], path),
    }
    needed = {name: "successes" if name == "curves" else name for name in draw}
    paths = {name: folder / f"{name}.png" for name in draw if needed[name] in made}
    for name, path in paths.items():
        draw[name](path)
    return paths


def write_report(results: Results, report: Report, params: ReportParams, out: Path) -> dict[str, pd.DataFrame]:
    """Write ``index.html`` and ``performance.md``, ``tables/`` and ``figures/``; return the tables.

    Parameters
    ----------
    results, params
        As from `read_results`, and what is shown of it.
    report : Report
        What else is shown.
    out : Path
        Folder.
    """
    made = make_tables(results, report, params)
    for name, table in made.items():
        tables.write_table(table, out / "tables" / f"{name}.csv")
    drawn = {**draw_figures(results, made, params, out / "figures"), **report.pictures}
    material = Material(
        results=results,
        params=params,
        tables=made,
        figures={name: path.relative_to(out).as_posix() for name, path in drawn.items()},
        origin=report.origin,
        rule=report.rule,
        cases=report.cases,
        gallery_kept="" if report.gallery is None else (report.gallery / "index.html").as_posix(),
        links=report.links,
    )
    Page(title=report.title, about=report.about, sections=all_sections(material)).write(out)
    if report.gallery is not None:
        write_gallery(report.cases, report.gallery)
    return made


def read_classifiers(training: Path, presets: Sequence[str]) -> pd.DataFrame:
    """Read the cross-validation of every preset, ``TRAINING/PRESET/metrics.csv``, with a column ``preset``."""
    parts = [read_table(training / preset / "metrics.csv", CLASSIFIER_COLUMNS) for preset in presets]
    return pd.concat([p.assign(preset=name) for name, p in zip(presets, parts, strict=True)], ignore_index=True)
