"""What one pays for what one gets: successes on hard pairs against seconds per pair, every input one point."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullFormatter

from epiprior_lab.report.results import Results
from epiprior_lab.report.style import label_grid, legend, looks_of, save, styled
from epiprior_lab.report.text import order_of

BEST, USUAL = "best", "usual"


def decision_table(
    timings: pd.DataFrame, results: Results, thresholds_px: Sequence[float], *, usual: str
) -> pd.DataFrame:
    """Return successes and seconds of every timed input, with the estimator that serves it best, and with the `usual`.

    Columns: ``input, choice`` (`BEST`: the most successes on these pairs below the first threshold, in hindsight; or
    `USUAL`, where the input has another), ``estimator, pairs, successes_<threshold>`` over the hard pairs, or all where none
    is hard; and medians over the timed pairs: ``seconds_pair``, from both files to F, and ``seconds_shared``, what a
    pair costs once the features of its images are there.
    """
    hard = results.hard_pairs
    member = hard if hard.any() else results.masks[results.main[-1]]
    timed = timings.assign(seconds_shared=timings["seconds_matching"] + timings["seconds_estimator"])
    medians = timed.groupby(["input", "estimator"])[["seconds_total", "seconds_shared"]].median().to_dict("index")
    rows = []
    for name in (name for name in results.inputs_of_all if name in set(timings["input"])):
        known = [e for e in results.estimators if name in results.inputs(e) and (name, e) in medians]
        counts = {e: [float(results.errors.of(e, name, px)[member].sum()) for px in thresholds_px] for e in known}
        best = max(known, key=lambda estimator: counts[estimator])
        for choice, estimator in ((BEST, best), *([(USUAL, usual)] if usual in known and usual != best else [])):
            row: dict[str, Any] = {"input": name, "choice": choice, "estimator": estimator, "pairs": int(member.sum())}
            row |= {f"successes_{px:g}": n for px, n in zip(thresholds_px, counts[estimator], strict=True)}
            found = medians[name, estimator]
            rows.append(row | {"seconds_pair": found["seconds_total"], "seconds_shared": found["seconds_shared"]})
    return pd.DataFrame(rows)


def decision_figure(table: pd.DataFrame, path: Path) -> None:
    """Draw a `decision_table`: a row per threshold, a column per way to count features; hollow for `USUAL`."""
    looks = looks_of(order_of(table["input"]))
    thresholds = [name for name in table.columns if name.startswith("successes_")]
    columns = {"seconds_pair": "features found for every pair", "seconds_shared": "features there already"}
    with styled(len(thresholds), 2, (9.6, 3.0 * len(thresholds) + 0.6), sharex=True, sharey="row") as (figure, axes):
        for row, counted in zip(axes, thresholds, strict=True):
            for axis, seconds in zip(row, columns, strict=True):
                for point in table.to_dict("records"):
                    look = looks[point["input"]]
                    face = look.colour if point["choice"] == BEST else "none"
                    axis.plot(point[seconds], point[counted], look.marker, color=look.colour, mfc=face, ms=8, mew=1.4)
                axis.set_xscale("log")
                axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                axis.xaxis.set_major_formatter("{x:g}")
                axis.xaxis.set_minor_formatter(NullFormatter())
                axis.set_ylim(0, 1.05 * max(float(np.max(table[thresholds].to_numpy())), 1.0))
            px = counted.removeprefix("successes_")
            row[0].set_ylabel(f"pairs of {int(table['pairs'].iloc[0])} below {px} px")
        label_grid(axes, columns=list(columns.values()), below="seconds per pair")
        legend(figure, list(looks.values()), markers=True)
        save(figure, path)
