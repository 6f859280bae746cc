"""Time: of each estimator by outcome, of the whole pipeline against what it contributes, and against successes."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.records import CASCADE, write_frame
from epiprior_lab.evaluation.statistics import contribution
from epiprior_lab.report import figures
from epiprior_lab.report.bounds import bound_table, judge
from epiprior_lab.report.cascade import cascade_table
from epiprior_lab.report.material import Material
from epiprior_lab.report.page import Block, Page, Table, picture
from epiprior_lab.report.results import Results, where
from epiprior_lab.report.style import label_grid, label_logarithmic, legend, looks_of, styled
from epiprior_lab.report.text import ALL, BASELINES, baseline_of, input_title, number, order_of, share

BEST, USUAL = "best", "usual"


def seconds_table(timings: pd.DataFrame, threshold_px: float) -> pd.DataFrame:
    """Return how long each estimator takes on each input when it succeeds and when it fails.

    Columns: ``estimator, input, outcome`` (``success`` or ``failure``), ``runs``, and mean, median and longest seconds
    of the estimator alone; outcomes that did not occur have no row. `timings` holds rows of `records.TimingRecord`.
    """
    table = timings[timings["input"] != CASCADE]
    table = table.assign(outcome=np.where(table["error_px"] < threshold_px, "success", "failure"))
    grouped = table.groupby(["estimator", "input", "outcome"], sort=False)["seconds_estimator"]
    return grouped.agg(runs="size", mean="mean", median="median", longest="max").reset_index()


def overhead_table(timings: pd.DataFrame, results: Results, threshold_px: float) -> pd.DataFrame:
    """Return the time with the preprocessing step over the time without, matching included.

    One row per input with the step (presets and `CASCADE`), group and estimator (`ALL` last, of both): ``runs``;
    ``seconds_without`` and ``seconds_with``, means over runs; ``overhead``, their ratio, the paper's definition;
    ``median_overhead``, the median over runs of the ratio of the same pair, estimator and seed; ``preprocessed``, the
    share of runs whose matches were ranked; ``contribution`` to successes, NaN over several estimators.
    """
    keys = ["group", "pair_id", "estimator", "seed"]
    baseline = timings[timings["input"].isin(BASELINES)][[*keys, "seconds_total"]]
    table = timings.merge(baseline, on=keys, suffixes=("", "_without"), validate="many_to_one")
    inputs = [name for name in order_of(timings["input"]) if name in ("paper", "fast", "default", CASCADE)]
    groups, estimators = ((*order_of(timings[column]), ALL) for column in ("group", "estimator"))
    rows = []
    for name, group, estimator in product(inputs, groups, estimators):
        asked = {"input": name, "group": group, "estimator": estimator}
        part = where(table, **{column: value for column, value in asked.items() if value != ALL})
        if part.empty:
            continue
        without, own = part["seconds_total_without"], part["seconds_total"]
        row: dict[str, Any] = {
            **asked,
            "runs": len(part),
            "seconds_without": without.mean(),
            "seconds_with": own.mean(),
        }
        row |= {"overhead": own.mean() / without.mean(), "median_overhead": (own / without).median()}
        row |= {"preprocessed": part["preprocessed"].mean(), "contribution": np.nan}
        if estimator != ALL and name != CASCADE:
            both = (baseline_of(name, results.inputs(estimator)), name)
            a, b = (results.errors.of(estimator, i, threshold_px)[results.masks[group]].mean() for i in both)
            row["contribution"] = float(contribution(a, b))
        rows.append(row)
    return pd.DataFrame(rows)


def decision_table(
    timings: pd.DataFrame, results: Results, thresholds_px: Sequence[float], cascade: pd.DataFrame, *, usual: str
) -> pd.DataFrame:
    """Return successes and seconds of every timed input, with the estimator that serves it best, and with the `usual`.

    `cascade` is a `cascade_table`; it is an input as well.

    Columns: ``input, choice`` (`BEST`: the most successes on these pairs below the first threshold, in hindsight; or
    `USUAL`, where the input has another), ``estimator, pairs, successes_<threshold>`` over the hard pairs, or all where
    none is hard; and means over the timed pairs: ``seconds_pair``, from both files to F, and ``seconds_shared``, what
    a pair costs once the features of its images are there.
    """
    hard = results.hard_pairs
    member, groups = (hard, results.hard) if hard.any() else (results.masks[results.main[-1]], results.main[-1:])
    of_cascade = cascade[cascade["group"].isin(groups)].groupby(["estimator", "threshold_px"])[CASCADE].sum()
    timed = timings.assign(seconds_shared=timings["seconds_matching"] + timings["seconds_estimator"])
    means = timed.groupby(["input", "estimator"])[["seconds_total", "seconds_shared"]].mean().to_dict("index")
    rows = []
    for name in (name for name in (*results.inputs_of_all, CASCADE) if name in set(timings["input"])):
        known = [e for e in results.estimators if (name, e) in means]
        if name == CASCADE:
            counts = {e: [float(of_cascade[e, px]) for px in thresholds_px] for e in known}
        else:
            counts = {e: [float(results.errors.of(e, name, px)[member].sum()) for px in thresholds_px] for e in known}
        best = max(counts, key=lambda estimator: counts[estimator])
        for choice, estimator in ((BEST, best), *([(USUAL, usual)] if usual in counts and usual != best else [])):
            row: dict[str, Any] = {"input": name, "choice": choice, "estimator": estimator, "pairs": int(member.sum())}
            row |= {f"successes_{px:g}": n for px, n in zip(thresholds_px, counts[estimator], strict=True)}
            seconds = means[name, estimator]
            rows.append(row | {"seconds_pair": seconds["seconds_total"], "seconds_shared": seconds["seconds_shared"]})
    return pd.DataFrame(rows)


def decision_figure(table: pd.DataFrame, path: Path) -> None:
    """Draw a `decision_table`: a row per threshold, a column per way to count features; hollow for `USUAL`."""
    looks = looks_of(order_of(table["input"]))
    thresholds = [name for name in table.columns if name.startswith("successes_")]
    columns = {"seconds_pair": "features found for every pair", "seconds_shared": "features there already"}
    size = (9.6, 3.0 * len(thresholds) + 0.6)
    with styled(path, len(thresholds), 2, size, sharex=True, sharey="row") as (figure, axes):
        for row, counted in zip(axes, thresholds, strict=True):
            for axis, seconds in zip(row, columns, strict=True):
                for point in table.to_dict("records"):
                    look = looks[point["input"]]
                    face = look.colour if point["choice"] == BEST else "none"
                    axis.plot(point[seconds], point[counted], look.marker, color=look.colour, mfc=face, ms=8, mew=1.4)
                axis.set_xscale("log")
                label_logarithmic(axis)
                axis.set_ylim(0, 1.05 * max(float(np.max(table[thresholds].to_numpy())), 1.0))
            px = counted.removeprefix("successes_")
            row[0].set_ylabel(f"pairs of {int(table['pairs'].iloc[0])} below {px} px")
        label_grid(axes, columns=list(columns.values()), below="seconds per pair")
        legend(figure, list(looks.values()), markers=True)


def write_timings(timings: pd.DataFrame, material: Material, out: Path) -> None:
    """Write tables, figures and a page of the times of an evaluation: ``times.md`` and what it shows.

    Of the `material` results, parameters, bounds, the rule of the cascade, which must be there, and the estimators that
    it was timed for.
    """
    results, params, thresholds, rule = material.results, material.params, material.thresholds, material.rule
    assert rule is not None
    overhead = overhead_table(timings, results, params.success_px)
    seconds, judged = seconds_table(timings, params.success_px), judge(material.bounds, {"overhead": overhead})
    cascade = cascade_table(results, rule, material.cascaded, thresholds)
    decision = decision_table(timings, results, thresholds, cascade, usual=params.champion)
    decision_figure(decision, out / "decision.png")
    tables = {"overhead": overhead, "estimators": seconds, "decision": decision, "bounds": judged}
    for name, table in tables.items():
        if len(table):
            write_frame(table, out / f"{name}.csv", digits=6)
    single = (overhead["group"] != ALL) & (overhead["estimator"] != ALL) & (overhead["input"] != CASCADE)
    figures.overhead_figure(overhead[single], out / "overhead.png")
    figures.seconds_figure(seconds, out / "estimators.png")
    rows = []
    for preset, part in overhead[overhead["group"] == ALL].groupby("input", sort=False):
        rows.append([input_title(str(preset))])
        for row in part.to_dict("records"):
            times = (number(row[n]) for n in ("seconds_without", "seconds_with", "overhead", "median_overhead"))
            rows.append([row["estimator"], str(row["runs"]), *times, share(row["preprocessed"])])
    of_times = ("estimator", "runs", "seconds without", "seconds with", "ratio", "ratio, median of runs")
    whole = Table(head=(*of_times, "runs preprocessed"), rows=rows)
    points = [
        [input_title(row["input"]), row["estimator"], *(number(row[f"successes_{px:g}"], 1) for px in thresholds)]
        + [number(row[name]) for name in ("seconds_pair", "seconds_shared")]
        for row in decision.to_dict("records")
    ]
    below = [f"below {px:g} px, of {int(decision['pairs'].iloc[0])}" for px in thresholds]
    head = ("matches", "estimator", *below, "seconds per pair", "once features are there")
    choice = Table(head=head, rows=points, texts=2)
    sections: dict[str, list[Block]] = {
        "What one pays": [choice, picture("decision", "decision.png")],
        "From images to F": [whole, picture("overhead", "overhead.png")],
        "Each estimator alone": [picture("estimators", "estimators.png")],
        "Bounds": [bound_table(judged)],
    }
    pairs, estimators = len(timings[["group", "pair_id"]].drop_duplicates()), timings["estimator"].nunique()
    about = f"{pairs} pairs, {estimators} estimators, one run at a time, matching included."
    Page(title="Times", about=about, sections=sections).write(out, markdown="times.md", html="")
