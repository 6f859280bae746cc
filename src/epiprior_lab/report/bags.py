"""The report on bags of photographs: tables, one figure, a page; the small table is that of the README too."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.bags.choose import PLAIN, STRANGER, TWINS
from epiprior_lab.bags.measure import INTRINSICS, SECONDS
from epiprior_lab.bags.params import BagReportParams
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.learned import LEARNED
from epiprior_lab.evaluation.records import write_frame
from epiprior_lab.evaluation.statistics import paired_bootstrap
from epiprior_lab.report.page import Block, Page, Table, picture, say
from epiprior_lab.report.results import interval_columns, where
from epiprior_lab.report.style import DOTS, label_grid, legend, styled
from epiprior_lab.report.text import ALL, DIFFICULTIES, INPUTS, best_bold, interval, number, order_of, share

TITLE = "Structure from motion on bags of photographs"
METHOD_TITLES: Mapping[str, str] = {
    "colmap": "COLMAP",
    "snn": "snn",
    **{name: INPUTS[name].label for name in LEARNED},
    "cascade": "cascade",
    "preprocess": "ours",
}
_LOOKS = {"colmap": "standard", "cascade": "fast", "preprocess": "default"}
_MEASURES = {"right": "registered and right", "accuracy": "pose accuracy"}
_Frame = pd.DataFrame


def write_bag_report(records: _Frame, methods: Sequence[str], params: BagReportParams, out: Path) -> None:
    """Write ``tables``, ``figures``, ``timings`` and ``performance.md``.

    `records` have the columns of `bags.measure.BagRecord` and ``difficulty``; those of `methods` without any are shown
    as not present.
    """
    summary, intruders = summary_table(records, params), intruder_table(records)
    tables = {"bags": records.drop(columns=list(SECONDS)), "summary": summary, "intruders": intruders}
    for name, table in tables.items():
        write_frame(table, out / "tables" / f"{name}.csv", digits=6)
    bag_figure(summary, out / "figures" / "bags.png")
    write_frame(records[["bag", "method", "intrinsics", *SECONDS]], out / "timings" / "seconds.csv", digits=6)
    times: dict[str, list[Block]] = {"Processor time": [say("sfm times"), _times(records, params)]}
    page = Page(title=f"{TITLE}: time", about=say("sfm time"), sections=times)
    page.write(out / "timings", markdown="times.md", html="")
    small = small_table(summary, intruders, methods, params.sizes)
    about = say("sfm summary", sizes=" and ".join(map(str, params.sizes)))
    sections: dict[str, list[Block]] = {
        "How well it works": [about, small],
        "By size and difficulty": [picture("bags", "figures/bags.png"), *_by_selection(summary)],
    }
    Page(title=TITLE, about=say("sfm"), sections=sections).write(out, html="")


def summary_table(records: _Frame, params: BagReportParams) -> _Frame:
    """Return every measure of every method on the plain bags of each selection, with intervals over scenes.

    Selections are bags of one size; then, of the sizes of the totals, each difficulty, `ALL`, and each set. A method
    has a row where it has all bags of the selection. Columns: ``selection, intrinsics, method, bags, scenes, images,
    registered, wrong``, sums; ``right``, the share of photographs that are registered and not wrong, and ``accuracy``,
    means over bags; both with ``_gain`` over `params.against` and intervals; ``tracks`` per bag, and their length.
    """
    plain = records[records["kind"] == PLAIN]
    plain = plain.assign(right=(plain["registered"] - plain["wrong"]) / plain["images"])
    rows = []
    for (name, chosen), kind in product(_selections(plain, params.sizes), INTRINSICS):
        part = chosen[chosen["intrinsics"] == kind].set_index("bag")
        bags = part.index.unique()
        base = part[part["method"] == params.against].loc[bags]
        scenes, seed = list(base["group"] + "/" + base["scene"]), child_seed(params.seed, name, kind)
        for method, own in part.groupby("method", sort=False):
            if len(own) < len(bags):
                continue
            row: dict[str, Any] = {"selection": name, "intrinsics": kind, "method": method, "bags": len(bags)}
            row["scenes"] = len(set(scenes))
            row |= {key: int(own[key].sum()) for key in ("images", "registered", "wrong")}
            for key in _MEASURES:
                a, b = (one.loc[bags, key].to_numpy(np.float64) for one in (base, own))
                found = paired_bootstrap(a, b, groups=scenes, draws=params.bootstrap_draws, seed=seed)
                row |= interval_columns(key, found.with_step, scenes=row["scenes"])
                row |= interval_columns(f"{key}_gain", found.contribution, scenes=row["scenes"])
            tracks = own["tracks"].sum()
            row["tracks"] = tracks / len(bags)
            row["track_length"] = (own["tracks"] * own["track_length"]).sum() / tracks if tracks else np.nan
            rows.append(row)
    return pd.DataFrame(rows)


def _selections(plain: _Frame, sizes: Sequence[int]) -> Iterator[tuple[str, _Frame]]:
    for size in sorted(plain["size"].unique()):
        yield f"bags of {size}", plain[plain["size"] == size]
    total = plain[plain["size"].isin(sizes)]
    for level in DIFFICULTIES:
        yield level, total[total["difficulty"] == level]
    yield ALL, total
    for group in order_of(total["group"]):
        yield group, total[total["group"] == group]


def intruder_table(records: _Frame) -> _Frame:
    """Return what is registered that should not be, by kind of bag, intrinsics and method.

    ``bags``; ``others``, photographs of other places in them; ``strangers``, those that are registered; ``taken``, bags
    that have one; of the home's ``images`` those ``registered`` and those of them ``wrong``.
    """
    table = records[records["kind"] != PLAIN]
    table = table.assign(bags=1, taken=(table["strangers"] > 0).astype(int))
    sums = ["bags", "others", "strangers", "taken", "images", "registered", "wrong"]
    return table.groupby(["kind", "intrinsics", "method"], sort=False)[sums].sum().reset_index()


def small_table(summary: _Frame, intruders: _Frame, methods: Sequence[str], sizes: Sequence[int]) -> Table:
    """Return the table of the README: known intrinsics; bags of the sizes of totals, hard ones, strangers and twins."""
    known, strange = (table[table["intrinsics"] == INTRINSICS[0]].to_dict("records") for table in (summary, intruders))
    found = {(row["selection"], row["method"]): row for row in known}
    taken = {(row["kind"], row["method"]): row for row in strange}
    order = sorted(methods, key=list(METHOD_TITLES).index)
    there = [name for name in order if name in set(summary["method"])]
    head, columns = ["matches"], []
    for level in (*(f"bags of {size}" for size in sizes), "hard"):
        own = [found.get((level, name)) for name in there]
        if not any(own):
            continue
        head += [f"{level}: right of {next(row['images'] for row in own if row)}", "wrong", "accuracy"]
        columns.append(best_bold([row["registered"] - row["wrong"] if row else np.nan for row in own], 0))
        columns.append([str(row["wrong"]) if row else "" for row in own])
        columns.append(best_bold([row["accuracy"] if row else np.nan for row in own], 2))
    counts = ((STRANGER, "strangers", "strangers", "others"), (TWINS, "twins joined", "taken", "bags"))
    for kind, title, column, of in counts:
        rows = [taken.get((kind, name)) for name in there]
        head.append(title)
        columns.append([f"{row[column]} of {row[of]}" if row else "" for row in rows])
    cells = dict(zip(there, zip(*columns, strict=True), strict=True))
    absent = ("not present", *[""] * (len(columns) - 1))
    return Table(head=head, rows=[[METHOD_TITLES[name], *cells.get(name, absent)] for name in order])


def bag_figure(summary: _Frame, path: Path) -> None:
    """Draw both measures with intervals: a row per kind of intrinsics, a column per measure, a dot per method."""
    shown = [name for name in order_of(summary["selection"]) if name in (*DIFFICULTIES, ALL) or " " in name]
    methods = sorted(order_of(summary["method"]), key=list(METHOD_TITLES).index)
    looks = {n: replace(INPUTS[_LOOKS.get(n, n)], label=METHOD_TITLES[n], line="none") for n in methods}
    y = np.arange(len(shown), dtype=np.float64)[::-1]
    with styled(path, 2, 2, (8.4, 0.55 * len(shown) * 2 + 1.2), sharex=True, sharey=True) as (figure, axes):
        for axis, (kind, measure) in zip(chain(*axes), product(INTRINSICS, _MEASURES), strict=True):
            for k, (name, look) in enumerate(looks.items()):
                own = where(summary, method=name, intrinsics=kind).set_index("selection").reindex(shown)
                spans = [own[measure] - own[f"{measure}_low"], own[f"{measure}_high"] - own[measure]]
                height = y + 0.13 * ((len(looks) - 1) / 2 - k)
                style: Any = {"color": look.colour, "ms": 5, "lw": 1.0, **DOTS}
                axis.errorbar(own[measure], height, xerr=np.nan_to_num(spans), fmt=look.marker, **style)
            axis.set_yticks(y, shown)
            axis.set(xlim=(-0.02, 1.02), ylim=(-0.6, len(shown) - 0.4))
        label_grid(axes, rows=[f"{kind} intrinsics" for kind in INTRINSICS], columns=list(_MEASURES.values()))
        legend(figure, list(looks.values()), markers=True)


def _by_selection(summary: _Frame) -> Iterator[Table]:
    head = ["bags", "method", "registered", "wrong", "right", "gain", "accuracy", "gain", "tracks", "length"]
    for kind in INTRINSICS:
        rows: list[list[str]] = []
        for name, part in summary[summary["intrinsics"] == kind].groupby("selection", sort=False):
            first = part.iloc[0]
            rows.append([f"{name}: {first['bags']} bags, {first['scenes']} scenes"])
            for row in part.to_dict("records"):
                counts = [f"{row['registered']} of {row['images']}", str(row["wrong"])]
                right = [interval(row, "right", share), interval(row, "right_gain")]
                accuracy = [interval(row, "accuracy", number), interval(row, "accuracy_gain")]
                tracks = [number(row["tracks"], 0), number(row["track_length"])]
                rows.append(["", METHOD_TITLES[row["method"]], *counts, *right, *accuracy, *tracks])
        yield Table(head=head, rows=rows, texts=2, fold=f"{kind.capitalize()} intrinsics")


def _times(records: _Frame, params: BagReportParams) -> Table:
    plain = records[(records["kind"] == PLAIN) & records["size"].isin(params.sizes)]
    pairs = plain["images"] * (plain["images"] - 1) / 2
    each = plain.assign(features=plain["features_s"] / plain["images"], matching=plain["matching_s"] / pairs)
    rows = []
    for method, own in each.groupby("method", sort=False):
        mapping = [own.loc[own["intrinsics"] == kind, "mapping_s"].median() for kind in INTRINSICS]
        values = [own["features"].median(), own["matching"].median(), *mapping]
        rows.append([METHOD_TITLES[str(method)], *map(number, values)])
    head = ["method", "features, s per photograph", "matching, s per pair"]
    return Table(head=[*head, *(f"mapping, {kind}, s per bag" for kind in INTRINSICS)], rows=rows)
