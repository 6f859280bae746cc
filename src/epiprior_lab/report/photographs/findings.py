"""What the report on photographs says in whole sentences, made of the tables: what limits the results, and caveats."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from epiprior_lab.evaluation.photographs.truth import SPLITS
from epiprior_lab.features.matching import PRESETS
from epiprior_lab.params import ReportParams
from epiprior_lab.report.markdown import markdown_table
from epiprior_lab.report.photographs.results import ALL, OURS
from epiprior_lab.report.photographs.wording import best_bold, group_title, number, share
from epiprior_lab.report.study import order_of

ORIGIN = (
    "Models, hand-over and rules were fitted on rendered scenes. Photographs were evaluated between versions of the "
    "method, so they are not unseen in the strict sense. `snn` is handed over whole, because the cuts that suit "
    "rendered scenes harmed it on photographs; that favours the peer."
)


def verdict_sentence(successes: pd.DataFrame, champion: str, threshold_px: float) -> str:
    """Return that success ignores the verdict, and what would change if it did not."""
    at = successes[(successes["threshold_px"] == threshold_px) & (successes["group"] == ALL)]
    own = at[at["estimator"] == champion].set_index("input")
    ours, without = own.loc[OURS], own[own["gain"].isna()].iloc[0]
    lost = (at["successes"] - at["successes_ok"])[at["input"] == OURS]
    return (
        "Success looks at F alone, whatever the verdict (`status`) says of it. If only runs with the verdict `ok` "
        f"counted, {champion} would solve {ours['successes_ok']:.1f} pairs below {threshold_px:g} px on our matches "
        f"instead of {ours['successes']:.1f}, and {without['successes_ok']:.1f} without preprocessing instead of "
        f"{without['successes']:.1f}; the estimators would lose {lost.min():.1f} to {lost.max():.1f} each on ours."
    )


LIMITS_HEAD = (
    "hard pairs of", "pairs", "failing", "top 100, failing", "top 100, solved", "solved by it on another input",
    "by another on ours", "by any on any input",
)  # fmt: skip


def limits_rows(limits: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each row of `bounds.limits_table`."""
    return [
        [str(row["group"]), str(row["pairs"]), str(row["failing"])]
        + [number(row[f"precision_{kind}"]) for kind in ("failing", "solved")]
        + [str(row[name]) for name in ("other_input", "other_estimator", "anyone")]
        for row in limits.to_dict("records")
    ]


def limits_sentence(limits: pd.DataFrame, champion: str, threshold_px: float) -> str:
    """Return where the champion fails on our matches of hard pairs, and who else solves these pairs."""
    at = limits[limits["group"] == ALL]
    if at.empty:
        return "There is no hard pair."
    row = at.iloc[0]
    start = f"{champion} on our matches fails on {row['failing']} of {row['pairs']} hard pairs at {threshold_px:g} px."
    if not row["failing"]:
        return start
    return (
        f"{start} There the median precision of our top 100 is {number(row['precision_failing'])}, on the solved ones "
        f"{number(row['precision_solved'])}. In hindsight {row['other_input']} of the failing pairs are solved by "
        f"{champion} on another input, {row['other_estimator']} by another estimator on our matches, and "
        f"{row['anyone']} by any estimator on any input; the other {row['failing'] - row['anyone']} by none that was "
        "tried. A pair counts as solved if most runs succeed."
    )


def pose_sentence(geometry: pd.DataFrame, champion: str, params: ReportParams) -> str:
    """Return how many successes have a wrong pose all the same."""
    at = geometry[(geometry["group"] == ALL) & (geometry["input"] == OURS) & (geometry["posed_successes"] > 0)]
    if at.empty:
        return "No successful pair has a known pose."
    shares = (at["wrong_poses"] / at["posed_successes"]).set_axis(at["estimator"])
    own = f"{share(shares[champion])} with {champion}, " if champion in shares.index else ""
    return (
        f"An error below {params.success_px:g} px on control points may hide a wrong geometry where these cover a part "
        f"of the overlap only. Of the successes on our matches whose true pose is known, some have a pose error above "
        f"{max(params.pose_deg):g}°: {own}{share(shares.min())} to {share(shares.max())} over all estimators. The "
        "cells are areas under the curve of pose errors, in percent, over pairs with cameras: without / others / ours."
    )


def pose_rows(geometry: pd.DataFrame, pose_deg: Sequence[float]) -> tuple[list[str], list[list[str]]]:
    """Return head and cells: per estimator the area under the curve of pose errors on every input, at each limit."""
    at = geometry[(geometry["cameras"] > 0) & geometry["group"].isin((*SPLITS, ALL))]
    groups, middle = order_of(at["group"]), sorted(pose_deg)[len(pose_deg) // 2]
    places = [(group, middle) for group in groups if group != ALL]
    places += [(ALL, limit) for limit in sorted(pose_deg) if ALL in groups]
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        names = [name for name in order_of(at[at["estimator"] == estimator]["input"]) if name not in PRESETS] + [OURS]
        cells = [
            best_bold(f"{100 * records[estimator, group, name][f'auc_{limit:g}']:.0f}" for name in names)
            for group, limit in places
        ]
        rows.append([estimator, *cells])
    cameras = {group: int(at[at["group"] == group]["cameras"].iloc[0]) for group in groups}
    return ["estimator", *(f"{group_title(group, cameras[group])}, {limit:g}°" for group, limit in places)], rows


def pose_lines(geometry: pd.DataFrame, pose_deg: Sequence[float]) -> list[str]:
    """Return the table of `pose_rows`."""
    head, rows = pose_rows(geometry, pose_deg)
    return markdown_table(head, rows)


def calibration_sentences(calibration: pd.DataFrame) -> list[str]:
    """Return what hides behind the calibration error: how full the lowest bin is, and what the others say."""
    at = calibration[calibration["group"].isin((*SPLITS, ALL)) & calibration["preset"].eq(OURS)]
    whole = at[at["group"] == ALL]
    if whole.empty:
        return []
    row = whole.iloc[0]
    first = (
        f"{share(row['lowest_share'])} of all ranked matches are in the lowest bin of probability: that is why the "
        f"calibration error over all matches is as small as {number(row['expected_calibration_error'], 3)}; over the "
        f"other bins it is {number(row['upper_error'], 3)}."
    )
    texts = [first]
    for split in at[at["group"] != ALL].to_dict("records"):
        texts.append(
            f"{split['group'].capitalize()} pairs: the lowest bin has {share(split['lowest_share'])}, the error of the "
            f"others is {number(split['upper_error'], 3)}; the bin that is furthest off states "
            f"{number(split['gap_stated'])} where {number(split['gap_right'])} are right, the highest "
            f"{number(split['top_stated'])} where {number(split['top_right'])} are right."
        )
    return texts
