"""The tables as Markdown: the full one of ``reports/performance.md``, and short ones for the README."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from epiprior_lab.report.performance import ALL, COLUMNS, COMPARISONS
from epiprior_lab.report.study import order_of
from epiprior_lab.report.wording import (
    bound_rows,
    contribution_cell,
    difference_cell,
    family_title,
    percent,
    success_cell,
)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> list[str]:
    """Return the lines of a table whose first `texts` columns are text and the others numbers."""
    rule = "|" + "---|" * texts + "---:|" * (len(head) - texts)
    return ["| " + " | ".join(head) + " |", rule, *("| " + " | ".join(row) + " |" for row in rows)]


def performance_markdown(performance: pd.DataFrame, duels: pd.DataFrame, bounds: pd.DataFrame, champion: str) -> str:
    """Return successes, bounds and duels as text for a reader, successes in the shape of the paper's Table 2.

    Parameters
    ----------
    performance, duels : DataFrame
        As from `performance.performance_table` and `performance.duel_table`.
    bounds : DataFrame
        As from `bounds.bounds_table`.
    champion : str
        The estimator of the duels.
    """
    lines = [
        "# Successes without and with the preprocessing step",
        "",
        "Number of test pairs whose error (mean over control points of the root of the Sampson distance) is",
        "below the threshold: mean over seeds ± one standard deviation. The contribution is",
        "(with - without) / without, as in the paper, with a 95 % bootstrap interval over scenes; `new`",
        "where nothing succeeded without. `without`: X_L of the paper, or all matches above a similarity for",
        "`generalized-ransac`. `snn`: RootSIFT, mutual nearest neighbours, ratio test. `paper`: the method as",
        "printed, for the estimators of the paper. `default`: the method with our improvements. Every input is",
        "handed over in the way that did best on validation scenes.",
        "",
        "## Bounds",
        "",
        "What was wanted before the study was run, and what came out. What limits it, by runs that know the",
        "truth: [analysis/analysis.md](analysis/analysis.md), at its end.",
        "",
        *bounds_lines(bounds, champion),
    ]
    for threshold, at in performance.groupby("threshold_px", sort=False):
        lines += ["", f"## Below {threshold:g} px"]
        for family, part in at.groupby("family", sort=False):
            lines += ["", f"### {_heading(str(family))} ({part['pairs'].max()} pairs)", "", *_performance_lines(part)]
    lines += ["", f"## {champion} against every other estimator", "", _DUEL_NOTE.format(champion=champion)]
    for threshold, at in duels.groupby("threshold_px", sort=False):
        for name, part in at.groupby("input", sort=False):
            lines += ["", f"### `{name}` input, below {threshold:g} px", "", *_duel_lines(part)]
    return "\n".join(lines) + "\n"


_DUEL_NOTE = (
    "Pairs that {champion} is ahead on the same input, with a 95 % bootstrap interval over scenes; bold where the\n"
    "interval excludes zero."
)


def _heading(family: str) -> str:
    title = family_title(family)
    return title[0].upper() + title[1:] if family == ALL else title


def _performance_lines(part: pd.DataFrame) -> list[str]:
    head = ["estimator", *(f"`{name}`" for name in COLUMNS), *(f"`{b}` over `{a}`" for a, b in COMPARISONS)]
    return markdown_table(
        head,
        (
            [
                row["estimator"],
                *(success_cell(row, name) for name in COLUMNS),
                *(contribution_cell(row, f"{b}_over_{a}") for a, b in COMPARISONS),
            ]
            for row in part.to_dict("records")
        ),
    )


def _duel_lines(part: pd.DataFrame) -> list[str]:
    families = order_of(part["family"])
    cells = part.set_index(["estimator", "family"]).to_dict("index")
    rows = []
    for estimator in order_of(part["estimator"]):
        texts = []
        for family in families:
            row = cells[estimator, family]
            text = difference_cell(row)
            texts.append(text if row["verdict"] == "open" else f"**{text}**")
        rows.append([estimator, *texts])
    return markdown_table(["against", *(family_title(family) for family in families)], rows)


def bounds_lines(bounds: pd.DataFrame, champion: str) -> list[str]:
    """Return the table of bounds: what was wanted, what was found, whether it is met."""
    rows = ([row["bound"], row["found"], row["met"]] for row in bound_rows(bounds, champion))
    return markdown_table(["bound", "found", "met"], rows, texts=3)


def successes_lines(performance: pd.DataFrame, threshold_px: float) -> list[str]:
    """Return one row per estimator, per family the successes ``without / snn / default``; the best of them is bold.

    Behind them the contribution of the default preset over the input without, over all families.
    """
    at = performance[performance["threshold_px"] == threshold_px]
    families = order_of(at["family"])
    cells = at.set_index(["estimator", "family"]).to_dict("index")
    head = ["estimator", *(f"{family_title(f)} ({cells[next(iter(cells))[0], f]['pairs']})" for f in families)]
    rows = []
    for estimator in order_of(at["estimator"]):
        texts = []
        for family in families:
            numbers = [f"{cells[estimator, family][name]:.1f}" for name in ("without", "snn", "default")]
            best = max(numbers, key=float)
            texts.append(" / ".join(f"**{text}**" if text == best else text for text in numbers))
        overall = cells[estimator, families[-1]]
        interval = f"[{percent(overall['default_over_without_low'])}, {percent(overall['default_over_without_high'])}]"
        rows.append([estimator, *texts, f"{percent(overall['default_over_without'])} {interval}"])
    return markdown_table([*head, "ours over without"], rows)


def duel_lines(duels: pd.DataFrame, threshold_px: float, families: Sequence[str]) -> list[str]:
    """Return one row per other estimator: how many pairs ahead the champion is, per family and input."""
    at = duels[duels["threshold_px"] == threshold_px]
    places = [(family, name) for family in families for name in order_of(at["input"])]
    cells = at.set_index(["estimator", "family", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        texts = []
        for family, name in places:
            row = cells[estimator, family, name]
            text = difference_cell(row)
            texts.append(text if row["verdict"] == "open" else f"**{text}**")
        rows.append([estimator, *texts])
    titles = {"default": "ours"}
    head = [f"{family_title(family)}, {titles.get(name, name)}" for family, name in places]
    return markdown_table(["against", *head], rows)
