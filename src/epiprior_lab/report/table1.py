"""The paper's Table 1: matches, right ones among the best, and who succeeds, on a few named pairs per family."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from epiprior_lab.report.study import COLUMNS, errors_of, order_of, read_table

# Columns of the table: its name, and preset and ranking of the rankings that it shows.
LISTS = {
    "Lowe (X_L)": ("paper", "lowe"),
    "BLOGS (X_B)": ("paper", "blogs"),
    "ours, `paper`": ("paper", "final"),
    "ours, `default`": ("default", "final"),
}
_INPUT_OF_LIST = {"Lowe (X_L)": "standard", "ours, `paper`": "paper", "ours, `default`": "default"}

_INTRODUCTION = """\
# Named pairs of every family: matches, right ones among the best, who succeeds

The paper's Table 1 on rendered test pairs. The pairs were chosen by a rule that knows no outcome: within each family at
the quantiles {quantiles} of the share of right matches in X_L, so from hard to easy. `Lowe`: X_L by distance ratio.
`BLOGS`: X_B by similarity weight. `ours`: the union of X, X_L and X_B by probability. Success: how many estimators, and
which, have an error below {success_px} px in most of their seeds, on the standard input and on ours (X_B alone is no
input of the study).

![The pairs, a row per family, in the order of the table](table1.jpg)"""


@dataclass(frozen=True, kw_only=True)
class FamilyResults:
    """What the evaluation says of one family.

    Parameters
    ----------
    results, rankings : DataFrame
        As the stage `evaluate` writes them.
    """

    results: pd.DataFrame
    rankings: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> FamilyResults:
        """Read the files of one family.

        Raises
        ------
        ReportError
            If one is missing or lacks a column.
        """
        return cls(**{name: read_table(folder / f"{name}.csv", COLUMNS[name]) for name in ("results", "rankings")})


def named_pairs(rankings: pd.DataFrame, quantiles: Sequence[float]) -> list[str]:
    """Return pairs at quantiles of the share of right matches in X_L, from hard to easy: by rule, not by outcome.

    Parameters
    ----------
    rankings : DataFrame
        Of one family.
    quantiles : sequence of float
        In [0, 1].
    """
    standard = rankings[(rankings["preset"] == "paper") & (rankings["ranking"] == "lowe")]
    share = (standard["right"] / standard["matches"].clip(lower=1)).to_numpy()
    ordered = standard.assign(share=share).sort_values(["share", "pair_id"], kind="stable")["pair_id"].tolist()
    places = dict.fromkeys(round(q * (len(ordered) - 1)) for q in quantiles)
    return [str(ordered[place]) for place in places]


def table1_markdown(families: Mapping[str, FamilyResults], quantiles: Sequence[float], success_px: float) -> str:
    """Return the table as text for a reader.

    Parameters
    ----------
    families : mapping of str to FamilyResults
        In the order of the table.
    quantiles : sequence of float
        Of `named_pairs`.
    success_px : float
        An estimator succeeds on a pair where most of its seeds are below this error, pixels.
    """
    levels = ", ".join(f"{q:g}" for q in quantiles)
    lines = [_INTRODUCTION.format(quantiles=levels, success_px=f"{success_px:g}")]
    for family, found in families.items():
        lines += ["", f"## {family}"]
        for pair_id in named_pairs(found.rankings, quantiles):
            lines += ["", *_pair_lines(found, pair_id, success_px)]
    return "\n".join(lines) + "\n"


def _pair_lines(found: FamilyResults, pair_id: str, success_px: float) -> list[str]:
    rankings = found.rankings[found.rankings["pair_id"] == pair_id].to_dict("records")
    by_place = {(row["preset"], row["ranking"]): row for row in rankings}
    columns = [by_place[place] for place in LISTS.values()]
    rows = {
        "matches": [f"{int(c['matches']):,}" for c in columns],
        "right matches": [f"{int(c['right']):,}" for c in columns],
        "right of the first 10": [f"{10 * float(c['precision_10']):.0f}" for c in columns],
        "right of the first 100": [f"{100 * float(c['precision_100']):.0f}" for c in columns],
        "success": [_success(found.results, pair_id, _INPUT_OF_LIST.get(name), success_px) for name in LISTS],
    }
    head = f"| `{pair_id}` | " + " | ".join(LISTS) + " |"
    lines = [head, "|---" + "|---:" * len(LISTS) + "|"]
    return lines + [f"| {name} | " + " | ".join(values) + " |" for name, values in rows.items()]


def _success(results: pd.DataFrame, pair_id: str, input_name: str | None, success_px: float) -> str:
    """Return how many estimators succeed in most seeds, and the shorter of who does and who does not."""
    part = results[(results["pair_id"] == pair_id) & (results["input"] == input_name)]
    if part.empty:
        return "–"
    names = order_of(part["estimator"])
    won = [n for n in names if (errors_of(part, estimator=n).to_numpy() < success_px).mean() > 0.5]
    lost = [n for n in names if n not in won]
    told = f"{len(won)} of {len(names)}"
    if not won or not lost:
        return told
    return f"{told}: {', '.join(won)}" if len(won) <= len(lost) else f"{told}, not {', '.join(lost)}"
