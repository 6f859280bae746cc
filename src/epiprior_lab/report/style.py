"""One look for all figures: colours that colour-blind readers tell apart, quiet axes, stable bytes."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib import rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from epiprior.types import FloatArray
from epiprior_lab.evaluation.statistics import success_curve
from epiprior_lab.report.text import INPUTS, Look

INK = "#2b2f36"
MUTED = "#7a828e"
GRID = "#e6e8ec"
CURVE_LIMIT_PX = 20.0
DOTS: Mapping[str, Any] = {"mec": "white", "mew": 0.6, "zorder": 3}  # of dots with error bars

_RC = rc_params_from_file(Path(__file__).parent / "templates" / "report.mplstyle", use_default_template=False)
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8b919b", "#2b2f36")
Sharing = bool | Literal["row", "col"]


@contextmanager
def styled(
    path: Path, rows: int, columns: int, size: tuple[float, float], *, sharex: Sharing = False, sharey: Sharing = False
) -> Iterator[tuple[Figure, list[list[Axes]]]]:
    """Yield a figure of `rows` x `columns` axes in the common style, its size in inches; then it is saved."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
        yield figure, [list(row) for row in axes]
        save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Write a PNG, or a JPEG for photographs, without metadata that would change from one installation to the next."""
    path.parent.mkdir(parents=True, exist_ok=True)
    how: Any = {"pil_kwargs": {"quality": 88}} if path.suffix == ".jpg" else {"metadata": {"Software": None}}
    figure.savefig(path, **how)


def legend(figure: Figure, looks: Sequence[Look], *, markers: bool = False, more: Sequence[Any] = ()) -> None:
    """Put one legend for all axes above them, with the markers of the series if these are drawn; `more` are handles."""
    handles = [
        Line2D([], [], c=one.colour, ls=one.line, marker=one.marker if markers else "", ms=5, label=one.label)
        for one in looks
    ]
    handles += more
    width = sum(0.7 + 0.062 * len(str(handle.get_label())) for handle in handles)  # inches, side by side
    rows = math.ceil(width / figure.get_figwidth())
    figure.legend(handles=handles, loc="outside upper center", ncols=-(-len(handles) // rows), handlelength=2.6)


def looks_of(names: Sequence[str], looks: Mapping[str, Look] = INPUTS) -> dict[str, Look]:
    """Return the looks of series in the order of `looks`; others are last and get a colour of the palette."""
    known = sorted(names, key=lambda name: list(looks).index(name) if name in looks else len(looks))
    return {name: looks.get(name) or Look(name, SERIES[k % len(SERIES)]) for k, name in enumerate(known)}


def axis_legend(figure: Figure, axis: Axes) -> None:
    """Put what is labelled in one axes above all of them."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))


def label_grid(
    axes: Sequence[Sequence[Axes]], *, rows: Sequence[str] = (), columns: Sequence[str] = (), below: str = ""
) -> None:
    """Name the rows on the left and the columns on top of a grid of axes, and the x axis below it."""
    for row, name in zip(axes, rows, strict=False):
        row[0].set_ylabel(name, fontweight="bold")
    for axis, name in zip(axes[0], columns, strict=False):
        axis.set_title(name)
    for axis in axes[-1] if below else ():
        axis.set_xlabel(below)


def label_logarithmic(axis: Axes) -> None:
    """Label 1, 2 and 5 of each power of ten along the x axis."""
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())


def draw_curves(
    axis: Axes, looks: Mapping[str, Look], errors_px: Mapping[str, FloatArray], bars_px: FloatArray, *, bold: str = ""
) -> None:
    """Draw successful pairs over the threshold of every series that has errors; bars are one deviation over seeds."""
    grid = np.linspace(0, CURVE_LIMIT_PX, 201)
    for k, (name, look) in enumerate(looks.items()):
        if name in errors_px:
            width = 2.4 if name == bold else 1.6
            axis.plot(grid, success_curve(errors_px[name], grid)[0], color=look.colour, ls=look.line, lw=width)
            at = bars_px + 0.22 * (k - (len(looks) - 1) / 2)  # side by side, so that bars do not hide bars
            mean, deviation = success_curve(errors_px[name], at)
            axis.errorbar(at, mean, deviation, fmt="none", ecolor=look.colour, elinewidth=0.8, alpha=0.8)
    axis.axvline(10, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
    axis.set_xlim(0, CURVE_LIMIT_PX)
