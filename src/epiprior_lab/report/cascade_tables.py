"""Tables of the cascade: what its rules lose against always preprocessing, and how often they preprocess."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import BoolArray
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.statistics import paired_bootstrap
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.performance import interval_cells
from epiprior_lab.report.study import order_of
from epiprior_lab.selection.cascade_rule import ALL, NEVER, PREPROCESSED, LearntRule, cascade_errors, kept_runs


def cascade_table(
    runs: Mapping[str, pd.DataFrame],
    rule: CascadeRule,
    *,
    thresholds_px: Sequence[float],
    draws: int,
    seed: int,
) -> pd.DataFrame:
    """Return what the cascade does with each estimator.

    Parameters
    ----------
    runs : mapping of str to DataFrame
        For each split the runs of all estimators, as from `cascade_rule.paired_runs`.
    rule : CascadeRule
        Of the cascade.
    thresholds_px : sequence of float
        Of success, pixels.
    draws, seed : int
        Of the bootstrap, which draws whole scenes.

    Returns
    -------
    DataFrame
        One row per split, estimator, family (``all`` last) and threshold: the rule; ``pairs``; ``preprocessed``,
        the share of runs that were; and in pairs, mean over seeds: successes ``without``, ``always`` and
        ``cascade``; ``lost`` and ``won``, the successes that only always preprocessing has, and only the
        cascade; ``change`` = cascade - always with the ends of its 95 % interval, ``_low`` and ``_high``.
    """
    rows = []
    for split, table in runs.items():
        for estimator in order_of(table["estimator"]):
            for family in (*order_of(table["family"]), ALL):
                part = table[table["estimator"] == estimator]
                part = (part if family == ALL else part[part["family"] == family]).reset_index(drop=True)
                (kept,) = kept_runs(part, [rule])
                for threshold in thresholds_px:
                    child = child_seed(seed, "cascade", split, estimator, family, str(threshold))
                    rows.append(
                        {
                            "split": split,
                            "estimator": estimator,
                            "family": family,
                            "threshold_px": threshold,
                            "min_spread": rule.min_spread,
                            "min_plausibility": rule.min_plausibility,
                            **_cells(part, kept, threshold, draws, child),
                        }
                    )
    return pd.DataFrame(rows)


def _cells(runs: pd.DataFrame, kept: BoolArray, threshold_px: float, draws: int, seed: int) -> dict[str, float]:
    errors = {
        "without": runs["without_px"].to_numpy(np.float64),
        "always": runs["with_px"].to_numpy(np.float64),
        "cascade": cascade_errors(runs, kept),
    }
    marks = pd.DataFrame({name: values < threshold_px for name, values in errors.items()})
    marks["lost"] = marks["always"] & ~marks["cascade"]
    marks["won"] = marks["cascade"] & ~marks["always"]
    shares = marks.groupby([runs["family"], runs["pair_id"], runs["scene"]], sort=True).mean()
    scenes = [str(scene) for scene in shares.index.get_level_values("scene")]
    change = paired_bootstrap(shares["always"], shares["cascade"], draws=draws, seed=seed, groups=scenes).difference
    pairs = len(shares)
    return {
        "pairs": pairs,
        "preprocessed": 1.0 - float(kept.mean()),
        **{str(name): pairs * float(shares[name].mean()) for name in shares.columns},
        **interval_cells("change", change, pairs),
    }


def cascade_seconds(overhead: pd.DataFrame, cascade: pd.DataFrame) -> pd.DataFrame:
    """Return the time that the cascade takes, and what it saves against always preprocessing.

    Parameters
    ----------
    overhead : DataFrame
        As from `epiprior_lab.evaluation.overhead.overhead_table`: seconds per pair without preprocessing and with it.
    cascade : DataFrame
        As from `cascade_table`.

    Returns
    -------
    DataFrame
        One row per family of test pairs and estimator: ``preprocessed`` (share of runs), ``seconds_without``,
        ``seconds_always``, ``seconds_cascade`` (the first, and for that share also the second: an upper bound,
        since features are found only once) and ``saved``, a share of the time of always preprocessing.
    """
    shares = cascade[cascade["split"] == "test"].drop_duplicates(["family", "estimator"])
    times = overhead[overhead["preset"] == PREPROCESSED].rename(columns={"seconds_with": "seconds_always"})
    table = times.merge(shares[["family", "estimator", "preprocessed"]], on=["family", "estimator"], how="inner")
    seconds = table["seconds_without"] + table["preprocessed"] * table["seconds_always"]
    table = table.assign(seconds_cascade=seconds, saved=1.0 - seconds / table["seconds_always"])
    keys = ["family", "estimator", "preprocessed"]
    return table[[*keys, "seconds_without", "seconds_always", "seconds_cascade", "saved"]]


def cascade_markdown(
    table: pd.DataFrame, learnt: LearntRule, params: CascadeParams, thresholds_px: tuple[float, float]
) -> str:
    """Return the tables for a reader: the rule on the runs it was learnt from, then the test pairs."""
    success_px, strict_px = thresholds_px
    lines = [
        "# The cascade: preprocessing only where it is needed",
        "",
        f"The estimator runs on matches without preprocessing first. {_rule_in_words(learnt.rule)}",
        "One rule serves all estimators, chosen on validation scenes: it preprocesses least and loses, against",
        "always preprocessing, at most",
        f"{100 * params.tolerance:g} % of the runs (pair, estimator and seed) below {success_px:g} px",
        f"and {100 * params.strict_tolerance:g} % below {strict_px:g} px. Held out: each scene under the rule that",
        f"the other scenes would have chosen. Lost: below {success_px:g} px.",
        "",
        "| estimator | preprocessed | lost | preprocessed, held out | lost, held out |",
        "|---|---:|---:|---:|---:|",
    ]
    columns = ("preprocessed", "lost", "held_out_preprocessed", "held_out_lost")
    for name, row in learnt.outcomes.iterrows():
        lines.append(f"| {' | '.join((str(name), *(f'{100 * row[column]:.1f} %' for column in columns)))} |")
    lines += [
        "",
        "Successes are numbers of pairs, mean over seeds. The change is of the cascade against always preprocessing,",
        "with its 95 % bootstrap interval over scenes; it can be won as well, where only the first answer is right.",
        "The tolerance is over all estimators together, so that a single one may lose more. On the test pairs the",
        f"largest losses are: {_largest_losses(table)}.",
        "",
        "Times are in [timings/cascade.csv](timings/cascade.csv). That of the cascade is an upper bound: a run that is",
        "preprocessed counts the features of both images twice, though they are found once.",
    ]
    test = table[table["split"] == "test"]
    for threshold, at in test.groupby("threshold_px", sort=False):
        for family, part in at.groupby("family", sort=False):
            title = "all families" if family == ALL else str(family)
            lines += ["", f"## Test pairs below {threshold:g} px: {title} ({part['pairs'].max()} pairs)", ""]
            lines += _markdown_rows(part)
    return "\n".join(lines) + "\n"


def _rule_in_words(rule: CascadeRule) -> str:
    if rule == NEVER:
        return "No rule kept to what is tolerated:\nevery pair is preprocessed."
    if rule.min_spread == 0:
        return (
            "Its answer is kept if it has an F whose\nplausibility (`epiprior.verification.plausibility`) is "
            f"at least {rule.min_plausibility:g}; otherwise the pair is preprocessed.\nHow far the inliers are spread "
            "decides nothing: the rule that was learnt asks for 0 cells of the images."
        )
    return (
        f"Its answer is kept if it has an F whose inliers lie in\nat least {rule.min_spread} cells of 48 x 48 pixels "
        "of each image and whose plausibility (`epiprior.verification.plausibility`) is\n"
        f"at least {rule.min_plausibility:g}; otherwise the pair is preprocessed."
    )


def _largest_losses(table: pd.DataFrame) -> str:
    """Return, for each threshold, the estimator that loses most over all test pairs."""
    whole = table[(table["split"] == "test") & (table["family"] == ALL)]
    told = []
    for threshold, at in whole.groupby("threshold_px", sort=False):
        worst = max(at.to_dict("records"), key=lambda row: float(row["lost"]))
        told.append(f"{worst['estimator']}, {worst['lost']:.1f} of {worst['pairs']} pairs below {threshold:g} px")
    return "; ".join(told)


def _markdown_rows(part: pd.DataFrame) -> list[str]:
    head = ("estimator", "without", "always", "cascade", "lost", "won", "change", "runs preprocessed")
    lines = [f"| {' | '.join(head)} |", "|---" + "|---:" * (len(head) - 1) + "|"]
    for row in part.to_dict("records"):
        lines.append(f"| {' | '.join(_markdown_cells(row))} |")
    return lines


def _markdown_cells(row: dict[Any, Any]) -> list[str]:
    counts = [f"{row[name]:.1f}" for name in ("without", "always", "cascade", "lost", "won")]
    change = f"{row['change']:+.1f} [{row['change_low']:+.1f}, {row['change_high']:+.1f}]"
    return [str(row["estimator"]), *counts, change, f"{100 * row['preprocessed']:.0f} %"]
