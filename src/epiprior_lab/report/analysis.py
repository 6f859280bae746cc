"""The page of the analysis and the paper's Table 1: everything that the stage `analysis` writes below ``reports/``."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from epiprior_lab.analysis.records import Analysis
from epiprior_lab.evaluation.records import Tables, write_frame
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import AnalysisParams, StudyParams
from epiprior_lab.report import analysis_results as found
from epiprior_lab.report.page import Block, Page, Picture, Table, picture, say
from epiprior_lab.report.pictures import contact_sheet
from epiprior_lab.report.results import ROUNDING, where
from epiprior_lab.report.text import Row, interval, listed, number, order_of, share, signed

_PARTS = ("standard", "2keypoint", "sfm")  # parts of the method as printed
_LABELS = {name: look.label for name, look in found.STEP_LOOKS.items()} | found.VARIANT_NAMES
_LABELS |= {"beyond": "`default`, another estimator", "paper": "`paper`", "default": "`default`"}
# Columns of Table 1: title, input and ranking of its list, input of its successes.
_LISTS = (
    ("Lowe (X_L)", "paper", "lowe", "standard"),
    ("BLOGS (X_B)", "paper", "blogs", ""),
    ("ours, `paper`", "paper", "final", "paper"),
    ("ours, `default`", "default", "final", "default"),
)


def write_analysis(
    analysis: Analysis, evaluated: Tables, pairs: Mapping[str, Sequence[Pair]], out: Path, params: StudyParams
) -> None:
    """Write tables, figures and pages of the analysis to a folder.

    `evaluated` is the evaluation of all groups, for Table 1, `pairs` are those of these groups, for their pictures.
    Every variant runs on the first estimator of the parameters.
    """
    report, own = params.report, params.analysis
    thresholds, how = (report.success_px, report.strict_px), {"draws": report.bootstrap_draws, "seed": report.seed}
    made = {
        "successes": found.success_table(analysis, own.estimators[0], thresholds_px=thresholds, **how),
        "precision": found.precision_table(analysis, **how),
        "lost": found.lost_table(analysis, thresholds),
    }
    for name, table in made.items():
        write_frame(table, out / f"{name}.csv")
    found.steps_figure(analysis, out / "steps.png")
    found.ablation_figure(made["precision"], made["successes"], thresholds, out / "ablations.png")
    found.lost_figure(made["lost"], out / "limits.png")
    _analysis_page(analysis, made, own).write(out, markdown="analysis.md", html="index.html")
    named = {group: named_pairs(evaluated.rankings, group, own.table_quantiles) for group in pairs}
    by_id = {(group, pair.pair_id): pair for group, members in pairs.items() for pair in members}
    contact_sheet({group: [by_id[group, n] for n in names] for group, names in named.items()}, out / "table1.jpg")
    page = table1_page(evaluated, named, own.table_quantiles, report.success_px)
    page.write(out, markdown="table1.md", html="")


def _analysis_page(analysis: Analysis, made: Mapping[str, pd.DataFrame], own: AnalysisParams) -> Page:
    """Return the page of the analysis; tables as from `analysis_results`."""
    estimator, successes, precision = own.estimators[0], made["successes"], made["precision"]
    hard = order_of(analysis.limits["group"])
    steps, ablation, oracle = (successes[successes["experiment"] == e] for e in ("steps", "ablation", "oracle"))
    several = steps["variant"].isin(["sfm", "paper"])  # ran on several estimators
    whole = (ablation["variant"] == "default") & (ablation["ranking"] == "final")
    easy = pd.concat([steps[several], ablation[ablation["variant"] == "X alone"], ablation[whole]])
    steps = steps[steps["group"].isin(hard) & ((steps["estimator"] == estimator) | ~several)]
    ablation = ablation[ablation["group"].isin(hard)]
    numbers = analysis.variants.groupby("group", sort=False)["pair_id"].nunique().unique()
    contents: dict[str, list[Block]] = {
        "Steps": [
            say("analysis steps", estimator=estimator),
            picture("steps", "steps.png"),
            *_success_blocks(steps, "all measures as printed"),
            _steps_read(steps),
        ],
        "Parts replaced": [
            say("analysis parts"),
            picture("ablations", "ablations.png"),
            *_precision_blocks(precision[precision["group"].isin(hard)]),
            *_success_blocks(ablation, "`default` as it is"),
            _ablations_read(ablation),
        ],
        "X alone against X with X_L and X_B": [
            say("analysis X alone"),
            *_success_blocks(easy[~easy["group"].isin(hard)], "the union"),
        ],
        "What limits the results": [
            say("analysis limits", refined=own.refined_hypotheses, estimator=estimator),
            _limits(found.limits_table(analysis)),
            *_success_blocks(oracle, "`default`"),
        ],
        "Where successes are lost": [say("analysis lost"), picture("limits", "limits.png"), _lost(made["lost"])],
    }
    pairs, seeds = listed([str(n) for n in sorted(numbers)]), analysis.variants["seed"].nunique()
    return Page(
        title="What each part contributes, and what limits the results",
        about=say("analysis page", pairs=pairs, seeds=seeds),
        sections=contents,
    )


def _steps_read(steps: pd.DataFrame) -> str:
    """Return, in words, where the whole method as printed comes out below a part of it."""
    above = steps[steps["variant"].isin(_PARTS) & (steps["difference"] > ROUNDING)]
    if above.empty:
        return say("analysis steps above")
    parts = []
    for variant in (name for name in _PARTS if (above["variant"] == name).any()):
        of_groups = above[above["variant"] == variant].groupby("group", sort=False)["threshold_px"]
        places = [f"{group} ({listed([f'{t:g}' for t in thresholds])} px)" for group, thresholds in of_groups]
        parts.append(f"*{_LABELS[variant]}* on {listed(places)}")
    return say("analysis steps below", parts="; ".join(parts), clear=_clear(above[above["difference_low"] > ROUNDING]))


def _ablations_read(ablation: pd.DataFrame) -> str:
    """Return, in words, which variants have a difference from `default` whose interval excludes zero."""
    compared = ablation[ablation["difference"].notna()]
    parts = []
    for ranking, rows in compared.groupby("ranking", sort=False):
        decided = (rows["difference_low"] > ROUNDING) | (rows["difference_high"] < -ROUNDING)
        parts.append(f"Of the {len(rows)} differences ranked by {ranking}, {_clear(rows[decided])}.")
    pairs = listed([str(n) for n in sorted(compared["pairs"].unique())])
    return " ".join([*parts, f"With {pairs} pairs of a group, small differences stay undecided."])


def _clear(rows: pd.DataFrame) -> str:
    """Return, in words, which differences these are, whose intervals exclude zero."""
    if rows.empty:
        return "none has an interval that excludes zero"
    places = [
        f"{_label(row)} on {row['group']} below {row['threshold_px']:g} px, {interval(row, 'difference', signed)}"
        for row in rows.to_dict("records")
    ]
    return f"{'this one has' if len(rows) == 1 else 'these have'} an interval that excludes zero: {'; '.join(places)}"


def _label(row: Row) -> str:
    return _LABELS.get(row["variant"], str(row["variant"]))


def _success_blocks(table: pd.DataFrame, reference: str) -> list[Block]:
    """Return a table per group: successes at every threshold, and the difference from a reference."""
    blocks: list[Block] = []
    for group, part in table.groupby("group", sort=False):
        head, keys = ["variant", "ranked by", "estimator"], ["variant", "ranking", "estimator"]
        for threshold in part["threshold_px"].unique():
            head += [f"below {threshold:g} px", f"against {reference}"]
        rows = []
        for (variant, ranking, estimator), own in part.groupby(keys, sort=False):
            cells = [_LABELS.get(str(variant), str(variant)), str(ranking), str(estimator)]
            for row in own.to_dict("records"):
                cells += [interval(row, "successes", lambda value: number(value, 1))]
                cells += [interval(row, "difference", signed) or "–"]
            rows.append(cells)
        blocks += [f"**{group}**, {part['pairs'].max()} pairs", Table(head=head, rows=rows, texts=3)]
    return blocks


def _precision_blocks(table: pd.DataFrame) -> list[Block]:
    head = ["variant", "ranked by", "right of the first 10", "right of the first 100", "average precision"]
    blocks: list[Block] = []
    for group, part in table.groupby("group", sort=False):
        rows = [
            [_label(row), row["ranking"], *(interval(row, name, number) for name in found.PRECISIONS)]
            for row in part.to_dict("records")
        ]
        blocks += [f"**{group}**, precision", Table(head=head, rows=rows, texts=2)]
    return blocks


def _limits(table: pd.DataFrame) -> Table:
    head = ["group", "pairs", "right one-to-one in X, median", "with 8 or more", "with 15 or more"]
    rows = [
        [row["group"], str(row["pairs"]), f"{row['right_in_x']:.0f}"]
        + [share(row["enough_8"]), share(row["enough_15"]), share(row["good_rough"], 1)]
        for row in table.to_dict("records")
    ]
    return Table(head=[*head, "good rough F, median"], rows=rows)


def _lost(table: pd.DataFrame) -> Table:
    rows = [
        [f"{row['threshold_px']:g} px", row["group"], row["estimator"], str(row["pairs"])]
        + [f"{row[name]:.1f}" for name in found.LOST]
        for row in table.to_dict("records")
    ]
    head = ["below", "group", "estimator", "pairs", *(label for label, _ in found.LOST.values())]
    return Table(head=head, rows=rows, texts=3)


def named_pairs(rankings: pd.DataFrame, group: str, quantiles: Sequence[float]) -> list[str]:
    """Return pairs at quantiles of the share of right matches in X_L, from hard to easy: by rule, not by outcome."""
    lists = where(rankings, group=group, input="paper", ranking="lowe")
    of_right = (lists["right"] / lists["matches"].clip(lower=1)).to_numpy()
    ordered = lists.assign(share=of_right).sort_values(["share", "pair_id"], kind="stable")["pair_id"].tolist()
    places = dict.fromkeys(round(q * (len(ordered) - 1)) for q in quantiles)
    return [str(ordered[place]) for place in places]


def table1_page(
    evaluated: Tables, named: Mapping[str, Sequence[str]], quantiles: Sequence[float], success_px: float
) -> Page:
    """Return the paper's Table 1 of the pairs `named`, by group, which `quantiles` chose; a section per group."""
    about = say("table 1", quantiles=", ".join(f"{q:g}" for q in quantiles), success_px=success_px)
    sheet = Picture(path="table1.jpg", alt="The pairs, a row per group, in the order of the table")
    sections: dict[str, list[Block]] = {"The pairs": [sheet]}
    sections |= {g: [_pair_block(evaluated, g, name, success_px) for name in names] for g, names in named.items()}
    title = "Named pairs of every group: matches, right ones among the best, who succeeds"
    return Page(title=title, about=about, sections=sections)


def _pair_block(evaluated: Tables, group: str, pair_id: str, success_px: float) -> Table:
    rankings, runs = (where(t, group=group, pair_id=pair_id) for t in (evaluated.rankings, evaluated.runs))
    of_list = rankings.set_index(["input", "ranking"])
    counts = {"matches": "matches", "right": "right matches"}
    counts |= {f"right_{n}": f"right of the first {n}" for n in (10, 100)}
    rows = [
        [title, *(f"{of_list[n].loc[(name, order)]:,}" for _, name, order, _ in _LISTS)] for n, title in counts.items()
    ]
    rows.append(["success", *(_success(runs[runs["input"] == name], success_px) for *_, name in _LISTS)])
    return Table(head=[f"`{pair_id}`", *(title for title, *_ in _LISTS)], rows=rows)


def _success(runs: pd.DataFrame, success_px: float) -> str:
    """Return how many estimators succeed in most seeds, and the shorter of who does and who does not."""
    if runs.empty:
        return "–"
    share_won = (runs["error_px"] < success_px).groupby(runs["estimator"], sort=False).mean()
    won, lost = (share_won.index[chosen].tolist() for chosen in (share_won > 0.5, share_won <= 0.5))
    told = f"{len(won)} of {len(share_won)}"
    if not won or not lost:
        return told
    return f"{told}: {', '.join(won)}" if len(won) <= len(lost) else f"{told}, not {', '.join(lost)}"
