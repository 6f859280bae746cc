"""Figure of the cascade: successes lost over the share of pairs that are preprocessed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import CascadeParams
from epiprior_lab.report.study import order_of
from epiprior_lab.report.style import MUTED, Look, save, styled
from epiprior_lab.selection.cascade_rule import kept_runs, lost_runs, trade_off

LOOKS: Mapping[str, Look] = {
    "validation": Look("validation", "#8b919b", "--", "s"),
    "test": Look("test", "#d55e00", "-", "o"),
}
_COLUMNS = 4


def cascade_figure(
    runs: Mapping[str, pd.DataFrame],
    rule: CascadeRule,
    params: CascadeParams,
    threshold_px: float,
    path: Path,
) -> Path:
    """Draw the trade-off of every estimator, one panel each: all candidate rules in hindsight, and the chosen one.

    Parameters
    ----------
    runs : mapping of str to DataFrame
        For each split the runs of all estimators, as from `cascade_rule.paired_runs`.
    rule : CascadeRule
        The chosen one, which is marked.
    params : CascadeParams
        Candidates and tolerance.
    threshold_px : float
        Of success, pixels.
    path : Path
        PNG file.
    """
    estimators = order_of(next(iter(runs.values()))["estimator"])
    columns = min(_COLUMNS, len(estimators))
    rows = -(-len(estimators) // columns)
    with styled(rows, columns, (2.6 * columns, 2.2 * rows + 0.6), sharex=True, sharey=True) as (figure, axes):
        panels = [axis for row in axes for axis in row]
        for axis, estimator in zip(panels, estimators, strict=False):
            for split, table in runs.items():
                part, look = table[table["estimator"] == estimator], LOOKS[split]
                front = trade_off(part, params, threshold_px)
                share, loss = front["preprocessed"].to_numpy(), front["lost"].to_numpy()
                axis.plot(
                    100 * np.append(1.0, share), 100 * np.append(loss[0], loss), color=look.colour, ls=look.line,
                    lw=1.4, drawstyle="steps-pre",
                )  # fmt: skip
                kept = kept_runs(part, [rule])
                lost = float(lost_runs(part, kept, threshold_px).mean())
                axis.plot(
                    100 * (1 - np.mean(kept)), 100 * lost, look.marker, color=look.colour, ms=7, mec="white",
                    zorder=4, clip_on=False,
                )  # fmt: skip
            axis.axhline(100 * params.tolerance, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
            axis.set(title=estimator, xlim=(0, 100))
        for axis in panels[len(estimators) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("runs lost, %")
        for axis in axes[-1]:
            axis.set_xlabel("runs preprocessed, %")
        for look in LOOKS.values():
            panels[0].plot([], [], color=look.colour, ls=look.line, marker=look.marker, label=look.label)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, [f"{label}, chosen rule" for label in labels], loc="outside upper center", ncols=2)
        return save(figure, path)
