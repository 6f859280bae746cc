"""Figure of the search for hand-overs on validation scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from epiprior_lab.report.study import Study, order_of
from epiprior_lab.report.style import INPUT_LOOKS, MUTED, legend, look_of, save, styled

_SETTING_NAMES = {
    "max_distance_ratio": "distance ratio,\nat most",
    "top_k": "best matches,\nat most",
    "min_probability": "probability,\nat least",
    "threshold_px": "inlier\nthreshold, px",
    "one_to_one": "one-to-one\nmatches",
    "refine": "F refined",
    "collect": "support\ncollected",
    "spread": "share per\ngrid cell",
}


def hand_over_figure(study: Study, path: Path) -> Path:
    """Draw the search: a row per estimator, a column per setting, a line per input, a ring around what was chosen.

    The height is what settings were chosen by: the mean of the pairs below 10 px and below 3 px.
    """
    search = study.hand_over.assign(score=(study.hand_over["successes_10"] + study.hand_over["successes_3"]) / 2)
    settings = [s for s in _SETTING_NAMES if (search["step"] == s).any()]
    estimators, inputs = order_of(search["estimator"]), order_of(search["input"])
    rows, columns = len(estimators), len(settings)
    size = (1.6 * columns + 0.9, 1.3 * rows + 1.1)
    with styled(rows, columns, size, sharey="row") as (figure, axes):
        for row, estimator in zip(axes, estimators, strict=True):
            part = search[search["estimator"] == estimator]
            for axis, setting in zip(row, settings, strict=True):
                _sweep_panel(axis, part, setting)
                if row is axes[0]:
                    axis.set_title(_SETTING_NAMES[setting], fontsize=9)
            row[0].set_ylabel(estimator, fontweight="bold")
            row[0].margins(y=0.14)
            row[0].yaxis.set_major_locator(MaxNLocator(4, integer=True))
        figure.supylabel("validation pairs, mean of those below 10 px and below 3 px", fontsize=9, color=MUTED)
        legend(figure, INPUT_LOOKS, [name for name in INPUT_LOOKS if name in inputs], markers=True)
        return save(figure, path)


def _sweep_panel(axis: Axes, part: pd.DataFrame, setting: str) -> None:
    """Draw the trials of one setting, and the best trial before it, from which they vary."""
    lines = []
    for k, name in enumerate(order_of(part["input"])):
        of_input = part[part["input"] == name]
        varied = of_input[of_input["step"] == setting]
        if varied.empty:
            continue
        before = of_input.loc[: varied.index[0]].iloc[:-1]
        trials = pd.concat([varied, before.sort_values(["score", "area"], kind="stable").tail(1)])
        chosen = of_input[of_input["chosen"].astype(str).str.lower() == "true"]
        lines.append((look_of(INPUT_LOOKS, name, k), trials, {_level(value) for value in chosen[setting]}))
    if not lines:
        axis.set_axis_off()
        return
    levels = _levels(setting, pd.concat([trials[setting] for _, trials, _ in lines]))
    for look, trials, final in lines:
        names = [_level(value) for value in trials[setting]]
        x = np.array([levels.index(name) for name in names])
        order = np.argsort(x, kind="stable")
        y = trials["score"].to_numpy()
        axis.plot(x[order], y[order], color=look.colour, ls=look.line, marker=look.marker, ms=3.2, lw=1.2)
        at = [k for k, name in enumerate(names) if name in final]
        axis.plot(x[at], y[at], "o", ms=8, mfc="none", mec=look.colour, mew=1.1)
    axis.set_xticks(range(len(levels)), levels)
    axis.set_xlim(-0.4, len(levels) - 0.6)


def _level(value: Any) -> str:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return "none" if pd.isna(value) else f"{float(value):g}"


def _levels(setting: str, values: pd.Series[Any]) -> list[str]:
    """Return the different values from strict to loose: no limit comes last, no floor comes first."""
    different = {_level(value): value for value in values}
    none = -np.inf if setting == "min_probability" else np.inf
    return sorted(different, key=lambda text: none if text == "none" else float(different[text]))
