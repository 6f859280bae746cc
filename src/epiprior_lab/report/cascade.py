"""The cascade: what it loses and saves against always preprocessing, and how its rule was learnt."""

from collections.abc import Mapping, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.page import Block, Page, Table, picture, say
from epiprior_lab.report.results import PAIR, Results
from epiprior_lab.report.style import MUTED, axis_legend, label_grid, styled
from epiprior_lab.report.text import Look, order_of, share
from epiprior_lab.selection import cascade_rule
from epiprior_lab.selection.cascade_rule import NEVER, LearntRule, kept_runs

_LOOKS: Mapping[str, Look] = {
    "validation": Look("validation, chosen rule", "#8b919b", "--", "s"),
    "test": Look("test, chosen rule", "#d55e00", "-", "o"),
}


def cascade_table(
    results: Results, rule: CascadeRule, estimators: Sequence[str], thresholds_px: Sequence[float]
) -> pd.DataFrame:
    """Return what the cascade does with each of the estimators; nothing is run again.

    One row per main group, estimator and threshold: ``pairs``; ``preprocessed``, the share of runs that were; and in
    pairs, mean over seeds: successes ``first``, ``always`` and ``cascade``; ``lost`` and ``won``, the successes that
    only always preprocessing has, and only the cascade; ``change``, cascade - always, with its 95 % interval.
    """
    runs = cascade_rule.paired_runs(results.tables.runs)
    (kept,) = kept_runs(runs, [rule])
    errors = {"first": runs["error_px"], "always": runs["with_error_px"]}
    errors["cascade"] = pd.Series(cascade_rule.cascade_errors(runs, kept))
    rows = []
    for estimator, threshold in product([e for e in order_of(runs["estimator"]) if e in estimators], thresholds_px):
        marks = runs[PAIR].assign(**{name: values < threshold for name, values in errors.items()}, preprocessed=~kept)
        marks["lost"] = marks["always"] & ~marks["cascade"]
        marks["won"] = marks["cascade"] & ~marks["always"]
        shares = results.by_pair(marks[runs["estimator"] == estimator].groupby(PAIR, as_index=False).mean()).fillna(0.0)
        always, cascade = (shares[name].to_numpy(np.float64) for name in ("always", "cascade"))
        for group, member in results.groups(results.main):
            pairs = int(member.sum())
            row: dict[str, Any] = {"group": group, "estimator": estimator, "threshold_px": threshold}
            row |= {"pairs": pairs, "preprocessed": float(shares.loc[member, "preprocessed"].mean())}
            row |= {name: float(shares.loc[member, name].sum()) for name in (*errors, "lost", "won")}
            change = results.compare(always, cascade, member, "cascade", estimator, group, str(threshold))
            rows.append(row | results.interval("change", change.difference, member, pairs))
    return pd.DataFrame(rows)


def rule_in_words(rule: CascadeRule) -> str:
    """Return what a rule keeps, as a sentence."""
    if rule == NEVER:
        return "No rule kept to what is tolerated: every pair is preprocessed."
    return (
        f"Its answer is kept if its confidence is at least {rule.min_confidence:g}, or if a homography relates the "
        f"images and its confidence is at most {1 - rule.min_confidence:g}; otherwise the pair is preprocessed."
    )


def learnt_page(learnt: LearntRule, params: CascadeParams, success_px: float, strict_px: float, figure: str) -> Page:
    """Return how the rule was learnt: its outcomes on validation scenes, and the figure of the trade-off."""
    names = ("preprocessed", "lost", "held_out_preprocessed", "held_out_lost")
    rows = [[str(name), *(share(row[n], 1) for n in names)] for name, row in learnt.outcomes.iterrows()]
    values = {"tolerance": params.tolerance, "strict_tolerance": params.strict_tolerance}
    about = say("learnt", rule=rule_in_words(learnt.rule), success_px=success_px, strict_px=strict_px, **values)
    head = ("estimator", "preprocessed", "lost", "preprocessed, held out", "lost, held out")
    sections: dict[str, list[Block]] = {
        "The rule on validation scenes": [Table(head=head, rows=rows), picture("cascade", figure)]
    }
    return Page(title="The cascade: preprocessing only where it is needed", about=about, sections=sections)


def cascade_figure(
    runs: Mapping[str, pd.DataFrame], rule: CascadeRule, params: CascadeParams, threshold_px: float, path: Path
) -> None:
    """Draw the trade-off of every estimator, one panel each: all candidate rules in hindsight, and the chosen one.

    `runs` are from `cascade_rule.paired_runs`, for ``validation`` and ``test``.
    """
    estimators = order_of(next(iter(runs.values()))["estimator"])
    columns = min(4, len(estimators))
    rows = -(-len(estimators) // columns)
    with styled(path, rows, columns, (2.6 * columns, 2.2 * rows + 0.6), sharex=True, sharey=True) as (figure, axes):
        panels = list(chain(*axes))
        for axis, estimator in zip(panels, estimators, strict=False):
            for split, table in runs.items():
                part, look = table[table["estimator"] == estimator], _LOOKS[split]
                front = cascade_rule.trade_off(part, params, threshold_px)
                x, loss = (100 * front[name].to_numpy() for name in ("preprocessed", "lost"))
                x, loss = np.append(100.0, x), np.append(loss[0], loss)
                axis.plot(x, loss, color=look.colour, ls=look.line, lw=1.4, drawstyle="steps-pre")
                kept = kept_runs(part, [rule])
                lost = 100 * float(cascade_rule.lost_runs(part, kept, threshold_px).mean())
                how: Any = {"color": look.colour, "ms": 7, "mec": "white", "zorder": 4, "clip_on": False}
                axis.plot(100 * (1 - np.mean(kept)), lost, look.marker, **how)
            axis.axhline(100 * params.tolerance, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
            axis.set(title=estimator, xlim=(0, 100))
        for axis in panels[len(estimators) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("runs lost, %")
        label_grid(axes, below="runs preprocessed, %")
        for look in _LOOKS.values():
            panels[0].plot([], [], color=look.colour, ls=look.line, marker=look.marker, label=look.label)
        axis_legend(figure, panels[0])
