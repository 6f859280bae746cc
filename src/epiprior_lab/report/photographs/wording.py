"""Numbers of the report on photographs as a reader sees them: cells, bounds, Markdown tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.features.matching import PRESETS, WITHOUT
from epiprior_lab.report.markdown import markdown_table
from epiprior_lab.report.photographs.bounds import CHAMPION, EASY, HARD
from epiprior_lab.report.photographs.results import ALL, OURS
from epiprior_lab.report.study import order_of
from epiprior_lab.report.wording import contribution_cell, percent

INPUT_NAMES = {"standard": "X_L", "generalized": "all similar", "default": "ours"}
NOT_PRESENT = "not present"


def input_name(name: str) -> str:
    """Return an input as tables call it."""
    return INPUT_NAMES.get(name, name)


def named(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose column `input` names inputs as tables call them."""
    return table.assign(input=[input_name(str(name)) for name in table["input"]])


def group_title(group: str, pairs: int) -> str:
    """Return the title of a group: ``hard pairs (61)``, ``all pairs (433)``, ``strecha (120)``."""
    return f"{group} pairs ({pairs})" if group in (*SPLITS, ALL) else f"{group} ({pairs})"


def share(value: float) -> str:
    """Return a share as a percentage."""
    return "" if np.isnan(value) else f"{100 * value:.0f} %"


def number(value: float, digits: int = 2) -> str:
    """Return a number, empty where there is none."""
    return "" if np.isnan(value) else f"{value:.{digits}f}"


def bound_rows(bounds: pd.DataFrame) -> list[dict[str, str]]:
    """Return each bound in words: ``bound, found, met`` (``yes`` or ``no``)."""
    return [
        {"bound": _bound(row), "found": _found(row), "met": "yes" if row["met"] else "no"}
        for row in bounds.to_dict("records")
    ]


def _bound(row: Mapping[Any, Any]) -> str:
    wanted, at = row["wanted"], f"{row['threshold_px']:g} px"
    if row["kind"] == HARD:
        return f"every estimator gains at least {percent(wanted)} over going without on hard pairs, {at}"
    if row["kind"] == EASY:
        return f"no estimator loses more than {-100 * wanted:g} % on easy pairs, {at}"
    if row["kind"] == CHAMPION:
        own = f"{row['estimator']} on our matches"
        return f"{own} is at least {percent(wanted)} ahead of the best peer on hard pairs, {at}"
    return f"precision of the top 100 at least {wanted:+.2f} over Lowe's order, all pairs"


def _found(row: Mapping[Any, Any]) -> str:
    if np.isnan(row["found"]):
        return "no such pair"
    interval = {"found": row["found"], "found_low": row["low"], "found_high": row["high"]}
    if row["kind"] in (HARD, EASY):
        kept = f"{row['kept']:.0f} of {row['of']:.0f} keep to it"
        # A loss of 1 % at most is missed by 1.3 %: whole numbers would not show it.
        lowest = contribution_cell(interval, "found") if row["kind"] == HARD else _gain(interval, "found", 100, 1, " %")
        return f"{kept}; lowest is {row['estimator']}: {lowest}"
    if row["kind"] == CHAMPION:
        limit = "" if np.isinf(row["possible"]) else f"; {percent(row['possible'])} if it solved every pair"
        estimator, _, name = str(row["against"]).partition(" on ")
        return f"{contribution_cell(interval, 'found')} over {estimator} on {input_name(name)}{limit}"
    interval_text = f"{row['found']:+.3f} [{row['low']:+.3f}, {row['high']:+.3f}]"
    scenes = f"{row['scene_found']:+.3f} as a mean over scenes"
    return f"{interval_text}; {scenes}; {row['possible']:+.3f} if all were right"


def set_rows(sets: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each known set: title, pairs, scenes, labels, and pairs of each split."""
    rows = []
    for row in sets.to_dict("records"):
        title = f"{row['title']} (the paper's)" if row["paper"] else str(row["title"])
        if row["state"] == NOT_PRESENT:
            rows.append([title, str(row["pairs"]), NOT_PRESENT, "", *("" for _ in SPLITS), ""])
            continue
        counts = [str(row[name]) for name in (*SPLITS, "unlabelled")]
        labels = str(row["labels"]) + (", reported apart" if row["state"] == "apart" else "")
        rows.append([title, str(row["pairs"]), str(row["scenes"]), labels, *counts])
    return rows


SET_HEAD = ("set", "pairs", "scenes", "labels", *SPLITS, "unlabelled")


def success_rows(at: pd.DataFrame) -> list[list[str]]:
    """Return one row per estimator of one threshold and group.

    Returns
    -------
    list of list of str
        Estimator; successes without, and on every other input; contribution of ours over without with its interval;
        scene shares without and with ours, and their difference with its interval; successes without and with ours if
        only the verdict `ok` counts.
    """
    others = [name for name in order_of(at["input"]) if name not in WITHOUT]
    rows = []
    for estimator, part in at.groupby("estimator", sort=False):
        cells = {str(row["input"]): row for row in part.to_dict("records")}
        without = next(row for name, row in cells.items() if name in WITHOUT)
        ours = cells[OURS]
        found = [without, *(cells.get(name) for name in others)]
        texts = ["" if row is None else f"{row['successes']:.1f} ± {row['successes_sd']:.1f}" for row in found]
        scenes = f"{share(without['scene_share'])} → {share(ours['scene_share'])}"
        change = _gain(ours, "scene_gain", 100, 0)
        ok = f"{without['successes_ok']:.1f} → {ours['successes_ok']:.1f}"
        rows.append([str(estimator), *texts, contribution_cell(ours, "gain"), scenes, change, ok])
    return rows


def success_head(at: pd.DataFrame) -> list[str]:
    """Return the head of `success_rows`."""
    others = [input_name(name) for name in order_of(at["input"]) if name not in WITHOUT]
    return ["estimator", "without", *others, "ours over without", "per scene", "points", "ok only"]


def _gain(row: Mapping[Any, Any], name: str, factor: float, digits: int, unit: str = "") -> str:
    """Return ``+0.14 [+0.09, +0.18]``; empty without a value, without brackets where there is no interval."""
    values = [factor * row.get(f"{name}{end}", np.nan) for end in ("", "_low", "_high")]
    value, low, high = (f"{0.0 if abs(v) < 0.5 / 10**digits else v:+.{digits}f}{unit}" for v in values)
    if np.isnan(values[0]):
        return ""
    return value + ("" if np.isnan(values[1]) else f" [{low}, {high}]")


def wrapped(text: str) -> list[str]:
    """Return the lines of a paragraph."""
    return textwrap.wrap(text, 110, break_long_words=False, break_on_hyphens=False)


def time_lines(bounds: pd.DataFrame, overhead: pd.DataFrame, pairs: pd.DataFrame) -> list[str]:
    """Return what was wanted of the time and what was found: medians, means over runs, seconds.

    Parameters
    ----------
    bounds, overhead : DataFrame
        As from `timing.bounds_of_time` and `timing.overhead_table`.
    pairs : DataFrame
        One row per run, as the stage `overhead` writes it.
    """
    whole = overhead[overhead["estimator"] == ALL].iloc[0]
    rows = []
    for row, mode in zip(bounds.to_dict("records"), ("with", "cascade"), strict=True):
        mean = float((pairs[f"seconds_{mode}"] / pairs["seconds_without"]).mean())
        seconds = f"{whole['seconds_without']:.2f} → {whole[f'seconds_{mode}']:.2f}"
        rows.append(
            [str(row["bound"]), f"at most {row['wanted']:g}", f"{row['found']:.2f}", f"{mean:.2f}", seconds]
            + ["yes" if row["met"] else "no"]
        )
    number_of_pairs = len(pairs[["set", "pair_id"]].drop_duplicates())
    return [
        *markdown_table(["bound", "wanted", "median", "mean", "seconds, median", "met"], rows),
        "",
        *wrapped(
            f"{number_of_pairs} pairs, {len(pairs)} runs of {pairs['estimator'].nunique()} estimators, ratios run by "
            f"run; the cascade preprocesses in {share(whole['preprocessed'])} of them."
        ),
    ]


def ranking_rows(rankings: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each group and ranking."""
    rows = []
    for row in rankings.to_dict("records"):
        texts = [f"{number(row[name])} / {number(row[f'scene_{name}'])}" for name in RANKING_MEASURES]
        texts.append(_gain(row, "precision_gain", 1, 2))
        rows.append([str(row["group"]), input_name(str(row["ranking"])), str(row["pairs"]), *texts])
    return rows


RANKING_MEASURES = ("precision_10", "precision_100", "precision_500", "average_precision")
RANKING_NOTE = (
    "Each cell: mean over pairs / mean over scenes of the means over their pairs, since some scenes have many pairs.",
    "A list that is shorter than 10, 100 or 500 counts as filled up with wrong matches, as in the paper. The average",
    "precision does not: it is over the right matches that a list has, and so speaks well of short ones.",
)
RANKING_HEAD = (
    "group", "ranking", "pairs", "top 10", "top 100", "top 500", "average precision", "top 100 over Lowe's order",
)  # fmt: skip


def ranking_lines(rankings: pd.DataFrame) -> list[str]:
    """Return the table of rankings."""
    return markdown_table(RANKING_HEAD, ranking_rows(rankings), texts=2)


def split_lines(successes: pd.DataFrame, threshold_px: float) -> list[str]:
    """Return one row per estimator; per split the successes on every input, ours last and the best bold; then our gain.

    The head names the inputs in their order. Last, for hard and for all pairs, the shares of successes as means over
    scenes, in percent: some scenes have many pairs.
    """
    at = successes[successes["threshold_px"] == threshold_px]
    groups = [group for group in order_of(at["group"]) if group in (*SPLITS, ALL)]
    by_scene = [group for group in groups if group in ("hard", ALL)]
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        own = order_of(at[at["estimator"] == estimator]["input"])
        names = [name for name in own if name not in PRESETS] + [OURS]
        texts = [best_bold(f"{records[estimator, group, name]['successes']:.1f}" for name in names) for group in groups]
        scenes = [
            best_bold(f"{100 * records[estimator, group, name]['scene_share']:.0f}" for name in names)
            for group in by_scene
        ]
        rows.append([estimator, *texts, contribution_cell(records[estimator, ALL, OURS], "gain"), *scenes])
    pairs = {group: int(at[at["group"] == group]["pairs"].iloc[0]) for group in groups}
    others = [input_name(name) for name in order_of(at["input"]) if name not in (*WITHOUT, *PRESETS)]
    return markdown_table(
        [
            " / ".join(["estimator: without", *others, "ours"]),
            *(group_title(group, pairs[group]) for group in groups),
            "ours over without",
            *(f"{group}, % per scene" for group in by_scene),
        ],
        rows,
    )


def best_bold(numbers: Iterable[str]) -> str:
    """Return numbers side by side, the highest bold."""
    texts = list(numbers)
    best = max(texts, key=float)
    return " / ".join(f"**{text}**" if text == best else text for text in texts)


def set_lines(
    sets: pd.DataFrame, successes: pd.DataFrame, rankings: pd.DataFrame, estimator: str, thresholds_px: Iterable[float]
) -> list[str]:
    """Return one row per set: precision of the top 100 / successes at each threshold, per input; then those absent."""
    thresholds = tuple(thresholds_px)
    mine = successes[successes["estimator"] == estimator]
    inputs = sorted(order_of(mine["input"]), key=lambda name: name == OURS)  # ours last
    found = mine.set_index(["group", "input", "threshold_px"])["successes"].to_dict()
    precision = rankings.set_index(["group", "ranking"])["precision_100"].to_dict()

    def cells(group: str) -> list[str]:
        texts = []
        for name in inputs:
            values = [number(precision.get((group, name), np.nan)) or "–"]
            values += [f"{found[group, name, threshold]:.1f}" for threshold in thresholds]
            texts.append(" / ".join(values))
        return texts

    absent = sets["state"] == NOT_PRESENT
    rows: list[Sequence[str]] = [
        [str(row["title"]), str(row["pairs"]), *cells(str(row["set"]))] for row in sets[~absent].to_dict("records")
    ]
    total = int(successes[successes["group"] == ALL]["pairs"].iloc[0])
    rows.append(["**total**", str(total), *cells(ALL)])
    if absent.any():
        titles = ", ".join(sets[absent]["title"].astype(str))
        rows.append([titles, str(sets[absent]["pairs"].sum()), *[NOT_PRESENT] * len(inputs)])
    return markdown_table(["set", "pairs", *(input_name(name) for name in inputs)], rows)
