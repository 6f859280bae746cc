"""The page of the analysis and the paper's Table 1: everything that the stage `analysis` writes below ``reports/``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from epiprior_lab.analysis.records import Analysis
from epiprior_lab.evaluation.records import Tables, write_frame
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
    errors_of,
    limits_table,
    lost_table,
    precision_table,
    success_table,
)
from epiprior_lab.report.page import Block, Page, Picture, Section, Table
from epiprior_lab.report.pictures import contact_sheet
from epiprior_lab.report.results import ROUNDING
from epiprior_lab.report.text import interval, listed, number, order_of, share, signed

_PARTS = ("standard", "2keypoint", "sfm")  # parts of the method as printed

_ABOUT = """\
On {pairs} test pairs of each group, with {seeds} seeds. Successes are pairs whose error (mean over control
points of the root of the Sampson distance) is below the threshold, in the mean over seeds; brackets hold 95 %
bootstrap intervals over scenes. Every estimator gets matches as was best for it on validation scenes; orders
by one measure alone are handed over in the same way. The paper's Table 1 is in [table1.md](table1.md)."""

_STEPS = """\
The paper's figure, with `{estimator}` where an estimator is used. *Standard input*: X_L. *2keypoints alone*:
matches of X ordered by the best match of 2keypoints that holds them. *Best single rough F*: the one with the
largest support among X, as it is, and after local optimisation, which the paper leaves to future work. *sfm
alone*: X ordered by the number of supported rough matrices (the paper learns a probability of it; here its
rank is used). *All measures, as printed*: the preset `paper`. The last two rows go beyond the paper: the
preset `default`, and another estimator on it."""

_ABLATIONS = """\
The preset `default` with one part replaced. Its two classifiers were trained with all parts in place, and the
column sfm means something else where the number of matrices or their accuracy changes. So each variant is
ranked twice: by the probabilities of that one model, and by sfm alone, which uses no model. Between the
variants the second is the fair comparison. *Two oriented matches*: a rough F from 8 points around two matches
instead of 16 around two matches of 2keypoints; it needs frames of SIFT. *X without X_L and X_B*: the matches
of X alone, which then miss their distance ratios and similarity weights as well. Precision is that under the
expected roll."""

_LIMITS = """\
Runs that know the truth, beside the preset `default`, which does not. *True labels*: the same matches, labels
instead of probabilities, same hand-over, compared with what the same estimator finds with the probabilities.
*Right matches*: F fitted to all right one-to-one matches, the best that their number and accuracy allow;
*refined on all*: then refined on all matches by their probabilities, as the method does. *Best rough F*: the
one with the smallest true error, and the best of {refined} such, refined on all matches by their
probabilities: both are chosen by the truth, so they say what is there, not what could be found. Runs without
an estimator are compared with `{estimator}`."""

_LOST = """\
Pairs, in the mean over seeds. Where one of the truly best rough matrices, refined, would have been a success,
the support of the chosen F among all one-to-one matches, weighted by their probabilities, is compared with
that of the truth: the highest support of any F of the runs above without an estimator whose error is below
the same threshold. The right F was *missed* if the chosen one has no more, and *outscored* if it has more:
then this support prefers a wrong F. `epiprior` does not optimise it (its own score is spread evidence times
plausibility), so for `epiprior` the split between missed and outscored says less. Otherwise there was *no
good hypothesis* where a fit to the right matches would have been a success, and *too few right matches* where
not even that."""

_TABLE1 = """\
The paper's Table 1 on rendered test pairs. The pairs were chosen by a rule that knows no outcome: within each
group at the quantiles {quantiles} of the share of right matches in X_L, so from hard to easy. *Lowe*: X_L by
distance ratio. *BLOGS*: X_B by similarity weight. *Ours*: the union of X, X_L and X_B by probability. All
lists are one-to-one. Success: how many estimators, and which, have an error below {success_px} px in most of
their seeds, on the standard input and on ours (X_B alone is no input of the study)."""

# Columns of Table 1: title, input and ranking of its list, input of its successes.
_LISTS = (
    ("Lowe (X_L)", "paper", "lowe", "standard"),
    ("BLOGS (X_B)", "paper", "blogs", ""),
    ("ours, `paper`", "paper", "final", "paper"),
    ("ours, `default`", "default", "final", "default"),
)


def write_analysis(
    analysis: Analysis,
    evaluated: Tables,
    pairs: Mapping[str, Sequence[Pair]],
    out: Path,
    *,
    estimator: str,
    thresholds_px: Sequence[float],
    quantiles: Sequence[float],
    refined: int,
    draws: int,
    seed: int,
) -> None:
    """Write tables, figures and pages of the analysis to a folder.

    Parameters
    ----------
    analysis : Analysis
        Records of the stage.
    evaluated : Tables
        The evaluation of all groups, for Table 1.
    pairs : mapping of str to sequence of Pair
        The pairs of these groups, for their pictures.
    out : Path
        Folder.
    estimator : str
        The one that every variant runs on.
    thresholds_px : sequence of float
        Thresholds of success, the paper's first.
    quantiles : sequence of float
        Of the named pairs of Table 1.
    refined : int
        How many rough matrices the oracle refined.
    draws, seed : int
        Of the bootstrap.
    """
    successes = success_table(analysis, estimator, thresholds_px=thresholds_px, draws=draws, seed=seed)
    precision = precision_table(analysis, draws=draws, seed=seed)
    lost = lost_table(analysis, thresholds_px)
    for name, table in (("successes", successes), ("precision", precision), ("lost", lost)):
        write_frame(table, out / f"{name}.csv")
    steps_figure(analysis, out / "steps.png")
    ablation_figure(precision, successes, thresholds_px, out / "ablations.png")
    lost_figure(lost, out / "limits.png")
    page = analysis_page(analysis, successes, precision, lost, estimator=estimator, refined=refined)
    page.write(out, markdown="analysis.md", html="index.html")
    named = {group: named_pairs(evaluated.rankings, group, quantiles) for group in pairs}
    shown = {
        group: [pair for name in names for pair in pairs[group] if pair.pair_id == name]
        for group, names in named.items()
    }
    contact_sheet(shown, out / "table1.jpg")
    table1_page(evaluated, named, quantiles, thresholds_px[0]).write(out, markdown="table1.md", html="")


def analysis_page(
    analysis: Analysis,
    successes: pd.DataFrame,
    precision: pd.DataFrame,
    lost: pd.DataFrame,
    *,
    estimator: str,
    refined: int,
) -> Page:
    """Return the page of the analysis; tables as from `analysis_tables`."""
    hard = order_of(analysis.limits["group"])
    steps, ablation, oracle = (successes[successes["experiment"] == e] for e in ("steps", "ablation", "oracle"))
    ours = (ablation["variant"] == "default") & (ablation["ranking"] == "final")
    alone = [steps[steps["variant"].isin(["sfm", "paper"])], ablation[ablation["variant"] == "X alone"], ablation[ours]]
    union = pd.concat(alone)
    figure = steps[
        steps["group"].isin(hard) & ((steps["estimator"] == estimator) | ~steps["variant"].isin(["sfm", "paper"]))
    ]
    ablation = ablation[ablation["group"].isin(hard)]
    number_of_pairs = analysis.variants.groupby("group", sort=False)["pair_id"].nunique().unique()
    return Page(
        title="What each part contributes, and what limits the results",
        about=_ABOUT.format(
            pairs=listed([str(n) for n in sorted(number_of_pairs)]), seeds=analysis.variants["seed"].nunique()
        ),
        sections=[
            Section(
                title="Steps",
                blocks=[
                    _STEPS.format(estimator=estimator),
                    Picture(path="steps.png", alt="Successful pairs over the threshold, a panel per group"),
                    *_success_blocks(figure, "all measures as printed"),
                    _steps_read(figure),
                ],
            ),
            Section(
                title="Parts replaced",
                blocks=[
                    _ABLATIONS,
                    Picture(path="ablations.png", alt="Precision and successes of the variants"),
                    *_precision_blocks(precision[precision["group"].isin(hard)]),
                    *_success_blocks(ablation, "`default` as it is"),
                    _ablations_read(ablation),
                ],
            ),
            Section(
                title="X alone against X with X_L and X_B",
                blocks=[
                    "The paper lost 3 to 7 % of an easy data set where it relied on X and sfm alone.",
                    *_success_blocks(union[~union["group"].isin(hard)], "the union"),
                ],
            ),
            Section(
                title="What limits the results",
                blocks=[
                    _LIMITS.format(refined=refined, estimator=estimator),
                    _limits(limits_table(analysis)),
                    *_success_blocks(oracle, "`default`"),
                ],
            ),
            Section(
                title="Where successes are lost",
                blocks=[
                    _LOST,
                    Picture(path="limits.png", alt="Where successes are lost, per group, estimator and threshold"),
                    _lost(lost),
                ],
            ),
        ],
    )


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
        places = [
            f"{group} ({listed([f'{t:g}' for t in rows[rows['group'] == group]['threshold_px']])} px)"
            for group in order_of(rows["group"])
        ]
        parts.append(f"*{_label(variant)}* on {listed(places)}")
    clear = [_place(row) for row in above[above["difference_low"] > ROUNDING].to_dict("records")]
    return (
        f"{told} Here, *all measures, as printed*, come out below, in the mean: {'; '.join(parts)}. "
        f"Of these differences, {_clear(clear)}."
    )


def _ablations_read(ablation: pd.DataFrame) -> str:
    """Return, in words, which variants have a difference from `default` whose interval excludes zero."""
    compared = ablation[ablation["difference"].notna()]
    parts = []
    for ranking in order_of(compared["ranking"]):
        rows = compared[compared["ranking"] == ranking]
        decided = (rows["difference_low"] > ROUNDING) | (rows["difference_high"] < -ROUNDING)
        clear = [_place(row) for row in rows[decided].to_dict("records")]
        parts.append(f"Of the {len(rows)} differences ranked by {ranking}, {_clear(clear)}.")
    pairs = listed([str(n) for n in sorted(compared["pairs"].unique())])
    parts.append(f"With {pairs} pairs of a group, small differences stay undecided.")
    return " ".join(parts)


def _clear(rows: Sequence[str]) -> str:
    if not rows:
        return "none has an interval that excludes zero"
    verb = "this one has" if len(rows) == 1 else "these have"
    return f"{verb} an interval that excludes zero: {'; '.join(rows)}"


def _place(row: Mapping[Any, Any]) -> str:
    gain = interval(row, "difference", signed)
    return f"{_label(row['variant'])} on {row['group']} below {row['threshold_px']:g} px, {gain}"


def _label(variant: str) -> str:
    if variant == "beyond":
        return "`default`, another estimator"
    if variant in ("paper", "default"):
        return f"`{variant}`"
    look = STEP_LOOKS.get(variant)
    return look.label if look else VARIANT_NAMES.get(variant, variant)


def _success_blocks(table: pd.DataFrame, reference: str) -> list[Block]:
    """Return a table per group: successes at every threshold, and the difference from a reference."""
    blocks: list[Block] = []
    for group, part in table.groupby("group", sort=False):
        thresholds = list(dict.fromkeys(part["threshold_px"]))
        head = ["variant", "ranked by", "estimator"]
        for threshold in thresholds:
            head += [f"below {threshold:g} px", f"against {reference}"]
        rows = []
        for (variant, ranking, estimator), own in part.groupby(["variant", "ranking", "estimator"], sort=False):
            cells = [_label(str(variant)), str(ranking), str(estimator)]
            for row in own.to_dict("records"):
                cells += [
                    interval(row, "successes", lambda value: number(value, 1)),
                    interval(row, "difference", signed) or "–",
                ]
            rows.append(cells)
        blocks += [f"**{group}**, {part['pairs'].max()} pairs", Table(head=head, rows=rows, texts=3)]
    return blocks


def _precision_blocks(table: pd.DataFrame) -> list[Block]:
    head = ["variant", "ranked by", "right of the first 10", "right of the first 100", "average precision"]
    measures = ("precision_10", "precision_100", "average_precision")
    blocks: list[Block] = []
    for group, part in table.groupby("group", sort=False):
        rows = [
            [_label(row["variant"]), row["ranking"], *(interval(row, m, number) for m in measures)]
            for row in part.to_dict("records")
        ]
        blocks += [f"**{group}**, precision", Table(head=head, rows=rows, texts=2)]
    return blocks


def _limits(table: pd.DataFrame) -> Table:
    head = [
        "group",
        "pairs",
        "right one-to-one in X, median",
        "with 8 or more",
        "with 15 or more",
        "good rough F, median",
    ]
    rows = [
        [row["group"], str(row["pairs"]), f"{row['right_in_x']:.0f}", share(row["enough_8"]), share(row["enough_15"]),
         share(row["good_rough"], 1)]
        for row in table.to_dict("records")
    ]  # fmt: skip
    return Table(head=head, rows=rows)


def _lost(table: pd.DataFrame) -> Table:
    rows = [
        [
            f"{row['threshold_px']:g} px",
            row["group"],
            row["estimator"],
            str(row["pairs"]),
            *(f"{row[n]:.1f}" for n in LOST),
        ]
        for row in table.to_dict("records")
    ]
    return Table(
        head=["below", "group", "estimator", "pairs", *(label for label, _ in LOST.values())], rows=rows, texts=3
    )


def named_pairs(rankings: pd.DataFrame, group: str, quantiles: Sequence[float]) -> list[str]:
    """Return pairs at quantiles of the share of right matches in X_L, from hard to easy: by rule, not by outcome.

    Parameters
    ----------
    rankings : DataFrame
        As in `Tables`.
    group : str
        Of the pairs.
    quantiles : sequence of float
        In [0, 1].
    """
    lists = rankings[(rankings["group"] == group) & (rankings["input"] == "paper") & (rankings["ranking"] == "lowe")]
    of_right = (lists["right"] / lists["matches"].clip(lower=1)).to_numpy()
    ordered = lists.assign(share=of_right).sort_values(["share", "pair_id"], kind="stable")["pair_id"].tolist()
    places = dict.fromkeys(round(q * (len(ordered) - 1)) for q in quantiles)
    return [str(ordered[place]) for place in places]


def table1_page(
    evaluated: Tables, named: Mapping[str, Sequence[str]], quantiles: Sequence[float], success_px: float
) -> Page:
    """Return the paper's Table 1, a section per group.

    Parameters
    ----------
    evaluated : Tables
        The evaluation of all groups.
    named : mapping of str to sequence of str
        Pair ids of each group.
    quantiles : sequence of float
        By which they were chosen.
    success_px : float
        An estimator succeeds on a pair where most of its seeds are below this error, pixels.
    """
    about = _TABLE1.format(quantiles=", ".join(f"{q:g}" for q in quantiles), success_px=f"{success_px:g}")
    pictures = Section(
        title="The pairs",
        blocks=[Picture(path="table1.jpg", alt="The pairs, a row per group, in the order of the table")],
    )
    sections = [
        Section(title=group, blocks=[_pair_block(evaluated, group, name, success_px) for name in names])
        for group, names in named.items()
    ]
    title = "Named pairs of every group: matches, right ones among the best, who succeeds"
    return Page(title=title, about=about, sections=[pictures, *sections])


def _pair_block(evaluated: Tables, group: str, pair_id: str, success_px: float) -> Table:
    def own(table: pd.DataFrame) -> pd.DataFrame:
        return table[(table["group"] == group) & (table["pair_id"] == pair_id)]

    rankings = own(evaluated.rankings)
    lists = [
        rankings[(rankings["input"] == name) & (rankings["ranking"] == ranking)].iloc[0]
        for _, name, ranking, _ in _LISTS
    ]
    rows = [[name, *(f"{each[column]:,}" for each in lists)] for name, column in (
        ("matches", "matches"), ("right matches", "right"),
        ("right of the first 10", "right_10"), ("right of the first 100", "right_100"),
    )]  # fmt: skip
    runs = own(evaluated.runs)
    rows.append(["success", *(_success(runs[runs["input"] == name], success_px) for *_, name in _LISTS)])
    return Table(head=[f"`{pair_id}`", *(title for title, *_ in _LISTS)], rows=rows)


def _success(runs: pd.DataFrame, success_px: float) -> str:
    """Return how many estimators succeed in most seeds, and the shorter of who does and who does not."""
    if runs.empty:
        return "–"
    names = order_of(runs["estimator"])
    won = [n for n in names if float((errors_of(runs, estimator=n) < success_px).to_numpy().mean()) > 0.5]
    lost = [n for n in names if n not in won]
    told = f"{len(won)} of {len(names)}"
    if not won or not lost:
        return told
    return f"{told}: {', '.join(won)}" if len(won) <= len(lost) else f"{told}, not {', '.join(lost)}"
