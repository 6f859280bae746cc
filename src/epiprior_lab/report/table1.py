"""The paper's Table 1: matches, right ones among the best, and who succeeds, on a few named pairs per group."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.compare import Rates
from epiprior_lab.evaluation.records import Tables, right_column
from epiprior_lab.report.page import Page, Picture, Section, Table
from epiprior_lab.report.prose import say

# Columns of the table: title, input and ranking of the list, input of the estimators that is shown with it.
LISTS = (
    ("X_L, by distance ratio", "paper", "lowe", "standard"),
    ("X_B, by similarity weight", "paper", "blogs", ""),
    ("ours, as printed", "paper", "final", "paper"),
    ("ours", "default", "final", "default"),
)


def named_pairs(pairs: pd.DataFrame, quantiles: Sequence[float]) -> list[str]:
    """Return `pairs` of one group at quantiles of the share of right matches in X_L: by rule, not by outcome."""
    ordered = pairs.dropna(subset="right_share").sort_values(["right_share", "pair_id"], kind="stable")["pair_id"]
    places = dict.fromkeys(round(q * (len(ordered) - 1)) for q in quantiles)
    return [str(ordered.iloc[place]) for place in places]


def table1_page(tables: Tables, quantiles: Sequence[float], success_px: float, *, picture: str) -> Page:
    """Return the table as a page; `picture` is the contact sheet of its pairs, relative to the page.

    An estimator succeeds on a pair where most of its seeds have an error below `success_px`.
    """
    rates = Rates(tables)
    sheet = Picture(path=picture, alt="The pairs, a row per group, in the order of the tables")
    sections = [Section(title="The pairs", blocks=[sheet])]
    for group, pairs in tables.pairs.groupby("group", sort=False):
        blocks = [_pair_table(tables, rates, str(group), name, success_px) for name in named_pairs(pairs, quantiles)]
        sections.append(Section(title=str(group), blocks=blocks))
    about = say("table1", quantiles=", ".join(f"{q:g}" for q in quantiles), success_px=success_px)
    return Page(title="Named pairs: matches, right ones among the best, who succeeds", about=about, sections=sections)


def _pair_table(tables: Tables, rates: Rates, group: str, pair_id: str, success_px: float) -> Table:
    found = tables.rankings[(tables.rankings["group"] == group) & (tables.rankings["pair_id"] == pair_id)]
    by_place = {(row["input"], row["ranking"]): row for row in found.to_dict("records")}
    lists = [by_place[name, ranking] for _, name, ranking, _ in LISTS]
    pairs = tables.pairs
    place = int(np.flatnonzero((pairs["group"] == group) & (pairs["pair_id"] == pair_id))[0])
    rows = [
        ["matches", *(f"{int(one['matches']):,}" for one in lists)],
        ["right matches", *(f"{int(one['right']):,}" for one in lists)],
        ["right of the first 10", *(str(int(one[right_column(10)])) for one in lists)],
        ["right of the first 100", *(str(int(one[right_column(100)])) for one in lists)],
        ["success", *(_success(rates, place, name, success_px) for *_, name in LISTS)],
    ]
    return Table(head=[f"`{pair_id}`", *(title for title, *_ in LISTS)], rows=rows)


def _success(rates: Rates, place: int, name: str, success_px: float) -> str:
    """Return how many estimators succeed in most seeds, and the shorter of who does and who does not."""
    who = [estimator for estimator in rates.estimators if name in rates.inputs(estimator)]
    if not who:
        return "–"
    won = [estimator for estimator in who if rates.of(estimator, name, success_px)[place] > 0.5]
    lost = [estimator for estimator in who if estimator not in won]
    told = f"{len(won)} of {len(who)}"
    if not won or not lost:
        return told
    return f"{told}: {', '.join(won)}" if len(won) <= len(lost) else f"{told}, not {', '.join(lost)}"
