"""A report: tables, figures and one page. The study, photographs and any folder are calls of `write_report`."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from epiprior_lab.evaluation.records import CASCADE, Tables, read_table, write_frame
from epiprior_lab.params import ReportParams
from epiprior_lab.report import figures, sections, tables
from epiprior_lab.report.bounds import judge
from epiprior_lab.report.cascade import cascade_table
from epiprior_lab.report.confidence import confidence_figure, confidence_table, kind_table
from epiprior_lab.report.gallery import write_gallery
from epiprior_lab.report.material import Extras, Maker, Material
from epiprior_lab.report.page import Page, Section, say
from epiprior_lab.report.results import Results
from epiprior_lab.report.text import ALL, DIFFICULTIES, OURS

TITLES = {
    "study": "Epipolar geometry with a prior: rendered scenes",
    "photographs": "Epipolar geometry with a prior: photographs",
    "folder": "Epipolar geometry with a prior: pair sets of your own",
}
CLASSIFIER_COLUMNS = "target family grouped fold metric value"
HAND_OVER_COLUMNS = "estimator input step top_k one_to_one threshold_px pairs successes_10 successes_3 area chosen"

_Tables = dict[str, pd.DataFrame]


def read_results(evaluated: Tables, params: ReportParams, *, apart: Sequence[str] = ()) -> Results:
    """Return results by group, or by difficulty where the hard groups of the parameters are difficulties."""
    by = "difficulty" if set(params.hard_groups) <= set(DIFFICULTIES) else "group"
    how = {"draws": params.bootstrap_draws, "seed": params.seed}
    return Results(evaluated, by=by, hard=params.hard_groups, apart=apart, **how)


def read_classifiers(training: Path, presets: Sequence[str]) -> pd.DataFrame:
    """Read the cross-validation of every preset, ``TRAINING/PRESET/metrics.csv``, with a column ``preset``."""
    parts = [read_table(training / preset / "metrics.csv", CLASSIFIER_COLUMNS) for preset in presets]
    return pd.concat([p.assign(preset=name) for name, p in zip(presets, parts, strict=True)], ignore_index=True)


def make_tables(results: Results, params: ReportParams, extras: Extras) -> _Tables:
    """Return all tables by the names of their files, those without rows left out."""
    thresholds = tuple(dict.fromkeys((params.success_px, params.strict_px)))
    success_px, champion = params.success_px, params.champion
    made = {
        "successes": tables.success_table(results, params.thresholds_px),
        "duels": tables.duel_table(results, champion, thresholds),
        "geometry": tables.geometry_table(results, params.pose_deg, params.distance_recall, success_px),
        "rankings": tables.ranking_table(results),
        "calibration": tables.calibration_table(results),
        "statuses": tables.status_table(results, success_px),
        "changed": tables.changed_table(results, thresholds),
        "sets": tables.set_table(results, extras.known_sets),
        "estimators": tables.estimator_table(results),
        "limits": tables.limits_table(results, champion, success_px),
        "pairs": tables.pair_table(results),
    }
    if extras.rule is not None and OURS in results.inputs_of_all:
        made["cascade"] = cascade_table(results, extras.rule, extras.cascaded, thresholds)
    if extras.classifiers is not None:
        made["classifiers"] = tables.classifier_table(extras.classifiers)
    if extras.hand_over is not None:
        made["hand_over"] = extras.hand_over
    if extras.kinds is not None:
        made["kinds"] = kind_table(extras.kinds, success_px)
        made["confidence"] = confidence_table(extras.kinds, success_px)
    made["bounds"] = judge(extras.bounds, made, results)
    return {name: table for name, table in made.items() if len(table)}


def draw_figures(results: Results, made: Mapping[str, pd.DataFrame], params: ReportParams, at: Path) -> dict[str, Path]:
    """Draw what the tables allow, and return the files by their names."""
    groups = [group for group, _ in results.groups(results.main[:-1])] or [ALL]
    thresholds, hard = list(dict.fromkeys((params.success_px, params.strict_px))), results.hard or (ALL,)
    draw: dict[str, Callable[[pd.DataFrame, Path], None]] = {
        "successes": lambda table, path: figures.success_figure(table, groups, thresholds, path),
        "curves": lambda _, path: figures.curve_figure(results, path),
        "duels": lambda table, path: figures.duel_figure(table, params.champion, hard, path),
        "rankings": lambda _, path: figures.ranking_figure(results, path),
        "calibration": lambda _, path: figures.calibration_figure(results, path),
        "statuses": lambda table, path: figures.status_figure(table, [*groups, ALL], path),
        "classifiers": figures.classifier_figure,
        "hand_over": figures.hand_over_figure,
    }
    paths = {}
    for name, function in draw.items():
        table = made.get("successes" if name == "curves" else name)
        if table is not None:
            paths[name] = at / f"{name}.png"
            function(table, paths[name])
    return paths


def _plain(name: str, *pictures: str) -> Maker:
    """Return what makes a section of prose and pictures alone."""
    return lambda m: iter([say(name), *(m.picture(one) for one in pictures)])


# In the order of the page: how well, how measured, what falls short, and bounds last. Title, what makes the section,
# and the table that it needs: without that it is left out.
SECTIONS: Sequence[tuple[str, Maker, str | None]] = (
    ("How well it works", sections.summary, None),
    ("A rescued pair", _plain("example", "example"), None),
    ("Successes", sections.successes, None),
    ("Against every other estimator", sections.duels, "duels"),
    ("Poses and distances", sections.poses, None),
    ("Rankings", sections.rankings, None),
    ("Calibration", sections.calibration, None),
    ("Cascade", sections.cascade, CASCADE),
    ("Turned and shrunk photographs", sections.changed, "changed"),
    ("Time", _plain("time", "decision", "overhead", "estimators"), None),
    ("Pairs", sections.pairs, None),
    ("How it was measured", sections.method, None),
    ("Hand-over", sections.hand_over, "hand_over"),
    ("Classifiers", sections.classifiers, "classifiers"),
    ("Roll", _plain("roll", "roll"), None),
    ("Analysis", _plain("analysis", "steps", "ablations", "limits"), None),
    ("Confidence", sections.confidence, "confidence"),
    ("Verification", sections.statuses, None),
    ("What limits the results", sections.limits, "limits"),
    ("Gallery", sections.gallery, None),
    ("Bounds", sections.bounds, "bounds"),
)


def write_report(results: Results, params: ReportParams, extras: Extras, kind: str, out: Path) -> _Tables:
    """Write ``index.html`` and ``performance.md``, ``tables/`` and ``figures/`` of a kind of `TITLES`."""
    made = make_tables(results, params, extras)
    for name, table in made.items():
        write_frame(table, out / "tables" / f"{name}.csv", digits=6)
    drawn = {**draw_figures(results, made, params, out / "figures"), **extras.pictures}
    if extras.kinds is not None:
        drawn["confidence"] = out / "figures" / "confidence.png"
        confidence_figure(extras.kinds, params.success_px, drawn["confidence"])
    paths = {name: path.relative_to(out).as_posix() for name, path in drawn.items()}
    material = Material(results=results, params=params, tables=made, figures=paths, kind=kind, extras=extras)
    shown = [
        Section(title=title, blocks=[block for block in make(material) if block])
        for title, make, needed in SECTIONS
        if needed is None or needed in made
    ]
    Page(title=TITLES[kind], about=say(kind), sections=shown).write(out)
    if extras.gallery is not None:
        write_gallery(extras.cases, extras.gallery)
    return made


def write_folder_report(evaluated: Tables, out: Path) -> None:
    """Write the report on pair sets of one's own, with the thresholds of the study; the first estimator is compared."""
    how: dict[str, Any] = {"success_px": 10.0, "strict_px": 3.0, "thresholds_px": (10.0, 3.0)}
    how |= {"pose_deg": (5.0, 10.0, 20.0), "distance_recall": 0.05, "bootstrap_draws": 2000, "seed": 0}
    how |= {"hard_groups": ("hard",), "easy_groups": ("easy",), "contact_sheet_pairs": None, "gallery": None}
    params = ReportParams(champion=str(evaluated.runs["estimator"].iloc[0]), **how)
    write_report(read_results(evaluated, params), params, Extras(), "folder", out)
