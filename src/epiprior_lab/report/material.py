"""What a report is made of: results, tables, figures and what is shown beside them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation.records import CASCADE
from epiprior_lab.pairsets import KnownSet
from epiprior_lab.params import ReportParams
from epiprior_lab.report import text
from epiprior_lab.report.bounds import Bound
from epiprior_lab.report.page import Block, Picture, Table, picture
from epiprior_lab.report.pictures import Case
from epiprior_lab.report.results import Results
from epiprior_lab.report.text import ALL, OURS, group_title, input_title, number, order_of

Maker = Callable[["Material"], Iterator[Block | tuple[()]]]


@dataclass(frozen=True, kw_only=True)
class Material:
    """Everything that a report of a `kind` of `report.TITLES` shows: the results, and what may be left out.

    `cascaded` are the estimators that the rule of the cascade is shown for. `known_sets` are listed even where they are
    not present. `classifiers` are from `read_classifiers`, `hand_over` is the search on validation scenes, `kinds` are
    the records of pairs of other kinds. `pictures`, by the names of the prose, and those of the `cases` are in the
    report's folder already; `gallery` is that of the cases on photographs. `report.write_report` adds `tables`, by the
    names of their files, and `figures`, paths relative to the page.
    """

    results: Results
    params: ReportParams
    kind: str
    rule: CascadeRule | None = None
    cascaded: Sequence[str] = ()
    bounds: Sequence[Bound] = ()
    known_sets: Sequence[KnownSet] = ()
    classifiers: pd.DataFrame | None = None
    hand_over: pd.DataFrame | None = None
    kinds: pd.DataFrame | None = None
    pictures: Mapping[str, Path] = field(default_factory=dict)
    cases: Sequence[Case] = ()
    gallery: Path | None = None
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    figures: Mapping[str, str] = field(default_factory=dict)

    @property
    def thresholds(self) -> tuple[float, ...]:
        """The limits of a success and of a strict one, pixels, once if they are the same."""
        return tuple(dict.fromkeys((self.params.success_px, self.params.strict_px)))

    def picture(self, name: str, **values: Any) -> tuple[Picture, ...]:
        """Return a figure; empty where there is none."""
        return (picture(name, self.figures[name], **values),) if name in self.figures else ()

    def groups_of(self, name: str) -> Iterator[tuple[str, pd.DataFrame]]:
        """Yield the rows of each main group of a table; nothing where there is no such table."""
        table = self.tables.get(name)
        if table is not None:
            yield from ((str(g), p) for g, p in table.groupby("group", sort=False) if g in self.results.main)


def summary_table(
    successes: pd.DataFrame,
    cascade: pd.DataFrame | None,
    rankings: pd.DataFrame | None,
    groups: Sequence[str],
    px: Sequence[float],
    seconds: Mapping[tuple[str, str], float] | None = None,
) -> Table:
    """Return the small table: per input shares of pairs that succeed, a column per threshold `px` and group.

    Every input has the estimator that serves it best over all pairs below the first threshold. Features per image are
    from the `rankings`, `seconds` what a pair takes, by input and estimator; without them there is no column.
    """
    features: dict[Any, float] = {}
    if rankings is not None and "features" in rankings:
        features = rankings[rankings["group"] == ALL].groupby("input")["features"].first().to_dict()
    columns = ["threshold_px", "group", "estimator", "pairs", "input", "successes"]
    table = successes[columns]
    if cascade is not None:
        own = cascade.assign(input=CASCADE, successes=cascade[CASCADE])
        table = pd.concat([table, own[columns]], ignore_index=True)
    whole = table[(table["group"] == ALL) & (table["threshold_px"] == px[0])]
    sizes = table.drop_duplicates("group").set_index("group")["pairs"]
    names = [name for name in order_of(whole["input"]) if name != "generalized"]
    who, values = [], []
    order = [*text.BASELINES, "snn", *text.PEERS, "paper", CASCADE, OURS]
    for name in sorted(names, key=lambda n: order.index(n) if n in order else 2):
        of_input = whole[whole["input"] == name].sort_values("successes", ascending=False, kind="stable")
        best = str(of_input["estimator"].iloc[0])
        own = table[(table["input"] == name) & (table["estimator"] == best)].set_index(["group", "threshold_px"])
        count = number(features.get(OURS if name == CASCADE else name, np.nan), 0)
        taken = [number(seconds.get((name, best), np.nan), 1)] if seconds else []
        who.append([input_title(name), best, *([count] if features else []), *taken])
        values.append([100 * own["successes"][g, t] / sizes[g] for t in px for g in groups])
    texts = zip(*(text.best_bold(column) for column in zip(*values, strict=True)), strict=True)
    head = ["matches", "estimator", *(["features"] if features else []), *(["seconds"] if seconds else [])]
    head += [f"{group_title(g, int(sizes[g]))}, {t:g} px" for t in px for g in groups]
    return Table(head=head, rows=[[*names, *cells] for names, cells in zip(who, texts, strict=True)], texts=2)
