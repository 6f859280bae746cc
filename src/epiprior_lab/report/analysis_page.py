"""What the analysis found, as text for a reader, and everything that its stage writes below ``reports/``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from epiprior_lab.pairsets import Pair
from epiprior_lab.report.analysis_figures import (
    LOST,
    STEP_LOOKS,
    VARIANT_NAMES,
    ablation_figure,
    lost_figure,
    steps_figure,
)
from epiprior_lab.report.analysis_tables import (
    Analysis,
    limits_table,
    lost_table,
    names_of,
    ranking_table,
    success_table,
)
from epiprior_lab.report.contact_sheet import contact_sheet
from epiprior_lab.report.performance import ROUNDING
from epiprior_lab.report.study import order_of
from epiprior_lab.report.table1 import FamilyResults, named_pairs, table1_markdown
from epiprior_lab.report.tables import write_table
from epiprior_lab.report.wording import difference_cell

_PARTS = ("standard", "2keypoint", "sfm")  # parts of the method as printed

_INTRODUCTION = """\
# What each part contributes, and what limits the results

On {pairs} test pairs of each family, with {seeds} seeds. Successes are pairs whose error (mean over control points of
the root of the Sampson distance) is below the threshold, in the mean over seeds; brackets hold 95 % bootstrap intervals
over scenes. Every estimator gets matches as was best for it on validation scenes, by the preset's own probabilities;
orders by one measure alone are handed over in the same way, but not cut by a probability that they do not carry."""

_STEPS = """\
## Steps

The paper's figure, with `{estimator}` where an estimator is used. *Standard input*: X_L. *2keypoints alone*: matches of
X ordered by the best match of 2keypoints that holds them. *Best single rough F*: the one with the largest support among
X, as it is, and after local optimisation, which the paper leaves to others. *sfm alone*: X ordered by the number of
supported rough matrices (the paper learns a probability of it; here its rank is used). *All measures, as printed*: the
preset `paper`. The last two rows go beyond the paper: the preset `default`, and another estimator on it.

![Successful pairs over the threshold, a panel per family](steps.png)"""

_ABLATIONS = """\
## Parts replaced

The preset `default` with one part replaced. Its two classifiers were trained with all parts in place, and the column
sfm means something else where the number of matrices or their accuracy changes. So each variant is ranked twice: by the
probabilities of that one model, and by sfm alone, which asks no model. Between the variants the second is the fair
comparison. *Two oriented matches*: a rough F from 8 points around two matches instead of 16 around two matches of
2keypoints; it needs frames of SIFT. *X without X_L and X_B*: the matches of X alone, which then miss their distance
ratios and similarity weights as well. Precision is that under the expected roll.

![Precision and successes of the variants](ablations.png)"""

_UNION = """\
## X alone against X with X_L and X_B

The paper lost 3 to 7 % of an easy data set where it relied on X and sfm alone."""

_LIMITS = """\
## What limits the results

Runs that know the truth, beside the preset `default`, which does not. *True labels*: the same matches, labels instead
of probabilities, same hand-over, compared with what the same estimator makes of the probabilities. *Right matches*: F
fitted to all right one-to-one matches, the ceiling that their number and accuracy set; *refined on all*: then refined
on all matches by their probabilities, as the method does. *Best rough F*: the one with the smallest true error, and the
best of {refined} such, refined on all matches by their probabilities: both are chosen by the truth, so they say what is
there, not what could be found. Runs without an estimator are compared with `{estimator}`."""

_LOST = """\
### Where successes are lost

Pairs, in the mean over seeds. Where one of the truly best rough matrices, refined, would have been a success, the
support of the chosen F among all one-to-one matches, weighted by their probabilities, is compared with that of the
truth: the most that any F of the runs above without an estimator has whose error is below the same threshold. The right
F was *missed* if the chosen one has no more, and *outscored* if it has more: then this support prefers a wrong F.
`epiprior` does not optimise it (its own score is spread evidence times plausibility), so for `epiprior` the split
between missed and outscored says less. Otherwise there was *no good hypothesis* where a fit to the right matches would
have been a success, and *too few right matches* where not even that.

![Where successes are lost, per family, estimator and threshold](limits.png)"""


def write_analysis(
    analysis: Analysis,
    evaluated: Mapping[str, FamilyResults],
    pairs: Mapping[str, Sequence[Pair]],
    out: Path,
    *,
    thresholds_px: Sequence[float],
    quantiles: Sequence[float],
    refined: int,
    draws: int,
    seed: int,
) -> list[Path]:
    """Write tables, figures and pages of the analysis.

    Parameters
    ----------
    analysis : Analysis
        Rows of the stage.
    evaluated : mapping of str to FamilyResults
        What the evaluation says of each family, for Table 1.
    pairs : mapping of str to sequence of Pair
        The pairs of these families, for their pictures.
    out : Path
        Folder.
    thresholds_px : sequence of float
        Thresholds of success, the paper's first.
    quantiles : sequence of float
        Of the named pairs of Table 1.
    refined : int
        How many rough matrices the oracle refined.
    draws, seed : int
        Of the bootstrap.

    Returns
    -------
    list of Path
        What was written.
    """
    successes = success_table(analysis, thresholds_px=thresholds_px, draws=draws, seed=seed)
    rankings = ranking_table(analysis, draws=draws, seed=seed)
    lost = lost_table(analysis, thresholds_px)
    written = [
        write_table(successes, out / "successes.csv"),
        write_table(rankings, out / "rankings.csv"),
        write_table(lost, out / "lost.csv"),
        steps_figure(analysis, out / "steps.png"),
        ablation_figure(rankings, successes, thresholds_px, out / "ablations.png"),
        lost_figure(lost, out / "limits.png"),
    ]
    named = {}
    for family, found in evaluated.items():
        by_id = {pair.pair_id: pair for pair in pairs[family]}
        named[family] = [by_id[pair_id] for pair_id in named_pairs(found.rankings, quantiles)]
    written.append(contact_sheet(named, out / "table1.jpg"))
    pages = {
        "analysis.md": analysis_markdown(analysis, successes, rankings, lost, thresholds_px, refined),
        "table1.md": table1_markdown(evaluated, quantiles, thresholds_px[0]),
    }
    for name, text in pages.items():
        (out / name).write_text(text, encoding="utf-8", newline="\n")
        written.append(out / name)
    return written


def analysis_markdown(
    analysis: Analysis,
    successes: pd.DataFrame,
    rankings: pd.DataFrame,
    lost: pd.DataFrame,
    thresholds_px: Sequence[float],
    refined: int,
) -> str:
    """Return the page of the analysis.

    Parameters
    ----------
    analysis : Analysis
        Rows of all pairs.
    successes, rankings, lost : DataFrame
        As from `analysis_tables`.
    thresholds_px : sequence of float
        Thresholds of success.
    refined : int
        How many rough matrices the oracle refined.
    """
    hard = analysis.complete_families
    easy = [family for family in analysis.families if family not in hard]
    number = analysis.results.groupby("family", sort=False)["pair_id"].nunique().unique()
    pairs = " or ".join(str(n) for n in sorted(number))
    steps, ablation, oracle = (successes[successes["experiment"] == e] for e in ("steps", "ablation", "oracle"))
    alone = pd.concat([steps[steps["variant"].isin(["sfm", "paper"])], ablation[ablation["variant"] == "X alone"],
                       ablation[(ablation["variant"] == "default") & (ablation["ranking"] == "final")]])  # fmt: skip
    figure = steps[(steps["estimator"] == analysis.estimator) | ~steps["variant"].isin(["sfm", "paper"])]
    lines = [
        _INTRODUCTION.format(pairs=pairs, seeds=analysis.results["seed"].nunique()),
        _STEPS.format(estimator=analysis.estimator),
        *_success_blocks(figure[figure["family"].isin(hard)], thresholds_px, "all measures as printed"),
        _steps_read(figure[figure["family"].isin(hard)]),
        _ABLATIONS,
        *_ranking_blocks(rankings[rankings["family"].isin(hard)]),
        *_success_blocks(ablation[ablation["family"].isin(hard)], thresholds_px, "`default` as it is"),
        _ablations_read(ablation[ablation["family"].isin(hard)]),
        _UNION,
        *_success_blocks(alone[alone["family"].isin(easy)], thresholds_px, "the union"),
        _LIMITS.format(refined=refined, estimator=analysis.estimator),
        _limit_rows(limits_table(analysis)),
        *_success_blocks(oracle, thresholds_px, "`default`"),
        _LOST,
        _lost_rows(lost),
    ]
    return "\n\n".join(lines) + "\n"


def _steps_read(steps: pd.DataFrame) -> str:
    """Return, in words, where the whole method as printed comes out below a part of it."""
    above = steps[steps["variant"].isin(_PARTS) & (steps["difference"] > ROUNDING)]
    told = (
        "In the paper, all measures do about as well as sfm alone, and better than standard input and 2keypoints alone."
    )
    if above.empty:
        return f"{told} Nor are they below any of these here, in the mean."
    parts = []
    for variant in (name for name in _PARTS if (above["variant"] == name).any()):
        rows = above[above["variant"] == variant]
        places = [f"{f} ({_thresholds(rows[rows['family'] == f])})" for f in order_of(rows["family"])]
        parts.append(f"*{_label(variant)}* on {' and '.join(places)}")
    clear = [_place(row) for row in above[above["difference_low"] > ROUNDING].to_dict("records")]
    return (
        f"{told} Here, *all measures, as printed*, come out below, in the mean: {'; '.join(parts)}. "
        f"Of these differences, {_listed(clear)}."
    )


def _ablations_read(ablation: pd.DataFrame) -> str:
    """Return, in words, which variants have a difference from `default` whose interval excludes zero."""
    compared = ablation[ablation["difference"].notna()]
    parts = []
    for ranking in order_of(compared["ranking"]):
        rows = compared[compared["ranking"] == ranking]
        decided = (rows["difference_low"] > ROUNDING) | (rows["difference_high"] < -ROUNDING)
        clear = [_place(row) for row in rows[decided].to_dict("records")]
        parts.append(f"Of the {len(rows)} differences ranked by {ranking}, {_listed(clear)}.")
    pairs = " or ".join(str(n) for n in sorted(compared["pairs"].unique()))
    parts.append(f"With {pairs} pairs of a family, small differences stay undecided.")
    return " ".join(parts)


def _listed(clear: Sequence[str]) -> str:
    if not clear:
        return "none has an interval that excludes zero"
    verb = "this one has" if len(clear) == 1 else "these have"
    return f"{verb} an interval that excludes zero: {'; '.join(clear)}"


def _place(row: Mapping[Any, Any]) -> str:
    return f"{_label(row['variant'])} on {row['family']} below {row['threshold_px']:g} px, {difference_cell(row)}"


def _thresholds(rows: pd.DataFrame) -> str:
    return " and ".join(f"{t:g}" for t in rows["threshold_px"]) + " px"


def _success_blocks(table: pd.DataFrame, thresholds_px: Sequence[float], reference: str) -> list[str]:
    """Return a table per family: successes at every threshold, and the difference from a reference."""
    blocks = []
    for family in order_of(table["family"]):
        part = table[table["family"] == family]
        pairs = int(part["pairs"].max())
        heads = [f"below {t:g} px | against {reference}" for t in thresholds_px]
        lines = [f"**{family}**, {pairs} pairs", "", "| variant | ranked by | estimator | " + " | ".join(heads) + " |"]
        lines.append("|---|---|---" + "|---:|---:" * len(heads) + "|")
        for key, rows in part.groupby(["variant", "ranking", "estimator"], sort=False):
            variant, ranking, estimator = names_of(key)
            by_threshold = {row["threshold_px"]: row for row in rows.to_dict("records")}
            cells = [_success_cells(by_threshold[t]) for t in thresholds_px]
            lines.append(f"| {_label(variant)} | {ranking} | {estimator} | " + " | ".join(cells) + " |")
        blocks.append("\n".join(lines))
    return blocks


def _success_cells(row: Mapping[Any, Any]) -> str:
    value = f"{row['successes']:.1f} [{row['successes_low']:.1f}, {row['successes_high']:.1f}]"
    if pd.isna(row["difference"]):
        return f"{value} | –"
    return f"{value} | {difference_cell(row)}"


def _label(variant: str) -> str:
    if variant == "beyond":
        return "`default`, another estimator"
    if variant in ("paper", "default"):
        return f"`{variant}`"
    look = STEP_LOOKS.get(variant)
    return look.label if look else VARIANT_NAMES.get(variant, variant)


def _ranking_blocks(table: pd.DataFrame) -> list[str]:
    blocks = []
    for family in order_of(table["family"]):
        lines = [
            f"**{family}**, precision",
            "",
            "| variant | ranked by | right of the first 10 | right of the first 100 | average precision |",
            "|---|---|---:|---:|---:|",
        ]
        for row in table[table["family"] == family].to_dict("records"):
            cells = [
                f"{row[m]:.2f} [{row[f'{m}_low']:.2f}, {row[f'{m}_high']:.2f}]"
                for m in ("precision_10", "precision_100", "average_precision")
            ]
            lines.append(f"| {_label(row['variant'])} | {row['ranking']} | " + " | ".join(cells) + " |")
        blocks.append("\n".join(lines))
    return blocks


def _limit_rows(table: pd.DataFrame) -> str:
    lines = [
        "| family | pairs | right one-to-one in X, median | with 8 or more | with 15 or more | good rough F, median |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in table.to_dict("records"):
        lines.append(
            f"| {row['family']} | {row['pairs']} | {row['right_in_x']:.0f} | {100 * row['enough_8']:.0f} % | "
            f"{100 * row['enough_15']:.0f} % | {100 * row['good_rough']:.1f} % |"
        )
    return "\n".join(lines)


def _lost_rows(table: pd.DataFrame) -> str:
    labels = [label for label, _ in LOST.values()]
    lines = [
        "| below | family | estimator | pairs | " + " | ".join(labels) + " |",
        "|---:|---|---" + "|---:" * (len(labels) + 1) + "|",
    ]
    for row in table.to_dict("records"):
        cells = [f"{row[name]:.1f}" for name in LOST]
        lines.append(
            f"| {row['threshold_px']:g} px | {row['family']} | {row['estimator']} | {row['pairs']} | "
            + " | ".join(cells)
            + " |"
        )
    return "\n".join(lines)
