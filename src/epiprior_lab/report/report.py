"""A report: tables, figures and one page. The study, photographs and any folder are calls of `write_report`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from epiprior.verification.cascade import load_cascade_rule
from epiprior_lab.evaluation.inputs import FIRST
from epiprior_lab.evaluation.protocol import MODELS, Protocol, as_shipped
from epiprior_lab.evaluation.records import CASCADE, Tables, read_table, write_frame
from epiprior_lab.params import EvaluateParams, ReportParams
from epiprior_lab.report import figures, sections, tables
from epiprior_lab.report.bounds import BOUNDS, judge, load_bounds
from epiprior_lab.report.cascade import cascade_table
from epiprior_lab.report.confidence import confidence_figure, confidence_table, kind_table
from epiprior_lab.report.material import Maker, Material
from epiprior_lab.report.page import Page, say
from epiprior_lab.report.pictures import write_gallery
from epiprior_lab.report.results import Results
from epiprior_lab.report.text import ALL, OURS

TITLES = {
    "study": "Epipolar geometry with a prior: rendered scenes",
    "photographs": "Epipolar geometry with a prior: photographs",
    "folder": "Epipolar geometry with a prior: pair sets of your own",
}
CLASSIFIER_COLUMNS = "target family grouped fold metric value"
HAND_OVER_COLUMNS = "estimator input step top_k one_to_one threshold_px pairs successes_10 successes_3 area chosen"


def read_material(own: EvaluateParams, params: ReportParams, kind: str, protocol: Protocol) -> Material:
    """Read what both the report and its times show: the evaluation, the rule of the cascade, and bounds."""
    evaluated = Tables.read([Path(own.out) / group for group in own.groups])
    results = Results(evaluated, params, apart=own.apart or ())
    how: dict[str, Any] = {"rule": load_cascade_rule(MODELS / "cascade.json"), "cascaded": as_shipped(protocol, FIRST)}
    return Material(results=results, params=params, kind=kind, bounds=load_bounds(BOUNDS, kind), **how)


def read_classifiers(training: Path, presets: Sequence[str]) -> pd.DataFrame:
    """Read the cross-validation of every preset, ``TRAINING/PRESET/metrics.csv``, with a column ``preset``."""
    parts = [read_table(training / preset / "metrics.csv", CLASSIFIER_COLUMNS) for preset in presets]
    return pd.concat([p.assign(preset=name) for name, p in zip(presets, parts, strict=True)], ignore_index=True)


def make_tables(m: Material) -> Mapping[str, pd.DataFrame]:
    """Return all tables by the names of their files, those without rows left out."""
    results, params, success_px, champion = m.results, m.params, m.params.success_px, m.params.champion
    made = {
        "successes": tables.success_table(results, params.thresholds_px),
        "duels": tables.duel_table(results, champion, m.thresholds),
        "geometry": tables.geometry_table(results, params.pose_deg, params.distance_recall, success_px),
        "rankings": tables.ranking_table(results),
        "calibration": tables.calibration_table(results),
        "statuses": tables.status_table(results, success_px),
        "changed": tables.changed_table(results, m.thresholds),
        "sets": tables.set_table(results, m.known_sets),
        "estimators": tables.estimator_table(results),
        "limits": tables.limits_table(results, champion, success_px),
        "pairs": tables.pair_table(results),
    }
    if m.rule is not None and OURS in results.inputs_of_all:
        made["cascade"] = cascade_table(results, m.rule, m.cascaded, m.thresholds)
    if m.classifiers is not None:
        made["classifiers"] = tables.classifier_table(m.classifiers)
    if m.hand_over is not None:
        made["hand_over"] = m.hand_over
    if m.kinds is not None:
        made["kinds"] = kind_table(m.kinds, success_px)
        made["confidence"] = confidence_table(m.kinds, success_px)
    made["bounds"] = judge(m.bounds, made, results)
    return {name: table for name, table in made.items() if len(table)}


def draw_figures(m: Material, at: Path) -> dict[str, Path]:
    """Draw what the tables allow, and return the files by their names."""
    results, params, kinds = m.results, m.params, pd.DataFrame() if m.kinds is None else m.kinds
    groups = [group for group, _ in results.groups(results.main[:-1])] or [ALL]
    draw: dict[str, Callable[[pd.DataFrame, Path], None]] = {
        "successes": lambda table, path: figures.success_figure(table, groups, m.thresholds, path),
        "curves": lambda _, path: figures.curve_figure(results, path),
        "duels": lambda table, path: figures.duel_figure(table, params.champion, results.hard or (ALL,), path),
        "rankings": lambda _, path: figures.ranking_figure(results, path),
        "calibration": lambda _, path: figures.calibration_figure(results, path),
        "statuses": lambda table, path: figures.status_figure(table, [*groups, ALL], path),
        "classifiers": figures.classifier_figure,
        "hand_over": figures.hand_over_figure,
        "confidence": lambda _, path: confidence_figure(kinds, params.success_px, path),
    }
    paths = {}
    for name, function in draw.items():
        table = m.tables.get("successes" if name == "curves" else name)
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


def write_report(material: Material, out: Path) -> Mapping[str, pd.DataFrame]:
    """Write ``index.html`` and ``performance.md``, ``tables/`` and ``figures/``; return the tables."""
    made = make_tables(material)
    for name, table in made.items():
        write_frame(table, out / "tables" / f"{name}.csv", digits=6)
    drawn = {**draw_figures(replace(material, tables=made), out / "figures"), **material.pictures}
    paths = {name: path.relative_to(out).as_posix() for name, path in drawn.items()}
    whole = replace(material, tables=made, figures=paths)
    shown = {title: list(make(whole)) for title, make, needed in SECTIONS if needed is None or needed in made}
    Page(title=TITLES[material.kind], about=say(material.kind), sections=shown).write(out)
    if material.gallery is not None:
        write_gallery(material.cases, material.gallery)
    return made


def write_folder_report(evaluated: Tables, out: Path) -> None:
    """Write the report on pair sets of one's own, with the thresholds of the study; the first estimator is compared."""
    how: dict[str, Any] = {"success_px": 10.0, "strict_px": 3.0, "thresholds_px": (10.0, 3.0)}
    how |= {"pose_deg": (5.0, 10.0, 20.0), "distance_recall": 0.05, "bootstrap_draws": 2000, "seed": 0}
    how |= {"hard_groups": ("hard",), "easy_groups": ("easy",), "contact_sheet_pairs": None, "gallery": None}
    params = ReportParams(champion=str(evaluated.runs["estimator"].iloc[0]), **how)
    write_report(Material(results=Results(evaluated, params), params=params, kind="folder"), out)
