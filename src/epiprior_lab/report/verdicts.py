"""How good the verdict on F is: right ones that it turns down, and wrong ones that it sees through.

Estimators are judged by their F whatever the verdict says of it; this is the verdict's own table.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import Patch

from epiprior.types import Status
from epiprior_lab.report.markdown import markdown_table
from epiprior_lab.report.performance import ALL
from epiprior_lab.report.study import Study, order_of
from epiprior_lab.report.style import INK, INPUT_LOOKS, look_of, save, styled

TURNED_DOWN = (Status.NO_MODEL, Status.DEGENERATE)
NOTE = (
    "An estimator is judged by its F, whatever the verdict says. The verdict is judged here, over the runs of all\n"
    "estimators that gave an F: right ones (error below {threshold:g} px) that it turns down, as `no_model` or\n"
    "`degenerate`, are false alarms, wrong ones are hits. Control points near one plane do not show a wrong epipole:\n"
    "there, an alarm that counts as false may be none."
)


def verdict_table(parts: Mapping[str, pd.DataFrame], threshold_px: float) -> pd.DataFrame:
    """Return what the verdict makes of right and of wrong F.

    Parameters
    ----------
    parts : mapping of str to DataFrame
        For each group its runs: ``input, status, error_px``, the error NaN without F.
    threshold_px : float
        Of a right F, pixels.

    Returns
    -------
    DataFrame
        One row per group and input (``all`` last): ``runs``; ``without_F``, those that gave no F; of the others
        ``right`` and ``wrong``, and of these ``<kind>_no_model``, ``<kind>_degenerate`` and the sum of both as a share,
        ``<kind>_turned_down``, NaN where there is none of the kind.
    """
    rows = []
    for group, runs in parts.items():
        names = order_of(runs["input"])
        for name in (*names, *([ALL] if len(names) > 1 else [])):
            part = runs if name == ALL else runs[runs["input"] == name]
            has_F = part["error_px"].notna()
            row: dict[str, Any] = {"group": group, "input": name, "runs": len(part), "without_F": int((~has_F).sum())}
            for kind, of_kind in (
                ("right", part["error_px"] < threshold_px),
                ("wrong", has_F & ~(part["error_px"] < threshold_px)),
            ):
                number = int(of_kind.sum())
                counts = {status: int((of_kind & (part["status"] == status)).sum()) for status in TURNED_DOWN}
                row |= {kind: number, **{f"{kind}_{status}": count for status, count in counts.items()}}
                row[f"{kind}_turned_down"] = sum(counts.values()) / number if number else np.nan
            rows.append(row)
    return pd.DataFrame(rows)


def study_verdicts(study: Study, threshold_px: float) -> pd.DataFrame:
    """Return `verdict_table` of a study: by family, all of them last."""
    by_family = dict(iter(study.results.groupby("family", sort=False)))
    parts = {family: by_family[family] for family in study.families}
    return verdict_table(parts | {ALL: study.results}, threshold_px)


def verdict_rows(table: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each row as a reader sees them, in the order of `VERDICT_HEAD`."""
    rows = []
    for row in table.to_dict("records"):
        cells = [str(row["group"]), str(row["input"]), str(row["without_F"])]
        for kind in ("right", "wrong"):
            share = row[f"{kind}_turned_down"]
            counts = [str(row[f"{kind}_{name}"]) for name in ("no_model", "degenerate")]
            cells += [str(row[kind]), *counts, "" if np.isnan(share) else f"{100 * share:.1f} %"]
        rows.append(cells)
    return rows


VERDICT_HEAD = (
    "group",
    "input",
    "runs without F",
    "right F",
    "of these no_model",
    "degenerate",
    "false alarms",
    "wrong F",
    "of these no_model",
    "degenerate",
    "hits",
)


def verdict_markdown(table: pd.DataFrame, threshold_px: float) -> list[str]:
    """Return the lines of a section of a Markdown report."""
    head = ["## The verdict", "", *NOTE.format(threshold=threshold_px).splitlines(), ""]
    return [*head, *markdown_table(VERDICT_HEAD, verdict_rows(table), texts=2)]


def verdict_figure(table: pd.DataFrame, path: Path) -> Path:
    """Draw the shares of right and of wrong F that are turned down: bars by group and input, ``no_model`` paler."""
    groups, inputs = order_of(table["group"]), [name for name in order_of(table["input"]) if name != ALL]
    width = 0.8 / max(len(inputs), 1)
    panels = (("right", "right F turned down: false alarms"), ("wrong", "wrong F turned down: hits"))
    with styled(1, 2, (2.2 + 1.7 * len(groups), 3.4)) as (figure, axes):
        for axis, (kind, title) in zip(axes[0], panels, strict=True):
            for k, name in enumerate(inputs):
                part = table[table["input"] == name].set_index("group").reindex(groups)
                number = part[kind].where(part[kind] > 0)
                bottom = (100 * part[f"{kind}_degenerate"] / number).fillna(0.0).to_numpy(np.float64)
                above = (100 * part[f"{kind}_no_model"] / number).fillna(0.0).to_numpy(np.float64)
                place = np.arange(len(groups)) + (k - (len(inputs) - 1) / 2) * width
                colour = look_of(INPUT_LOOKS, name, k).colour
                axis.bar(place, bottom, 0.9 * width, color=colour)
                axis.bar(place, above, 0.9 * width, bottom=bottom, color=colour, alpha=0.45)
            axis.set_xticks(range(len(groups)), groups, rotation=20 if len(groups) > 3 else 0)
            axis.grid(axis="x", visible=False)
            tallest = float(100 * table.loc[table["input"].isin(inputs), f"{kind}_turned_down"].max())
            axis.set(title=title, ylim=(0, 100 if kind == "wrong" or not tallest > 0 else min(1.15 * tallest, 100)))
        axes[0][0].set_ylabel("share of the runs, %")
        handles = [
            Patch(color=look.colour, label=look.label)
            for look in (look_of(INPUT_LOOKS, name, k) for k, name in enumerate(inputs))
        ]
        handles += [Patch(color=INK, label="full: degenerate"), Patch(color=INK, alpha=0.45, label="pale: no_model")]
        rows = 1 if len(handles) <= 6 else 2  # more do not fit side by side
        figure.legend(handles=handles, loc="outside upper center", ncols=-(-len(handles) // rows))
        return save(figure, path)
