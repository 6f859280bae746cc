"""One look for all figures: colours that colour-blind readers tell apart, quiet axes, stable bytes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
from matplotlib import rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from epiprior_lab.report.text import INPUT_TITLES, RANKING_TITLES

INK = "#2b2f36"
MUTED = "#7a828e"
GRID = "#e6e8ec"

_RC = rc_params_from_file(Path(__file__).parent / "templates" / "report.mplstyle", use_default_template=False)


@dataclass(frozen=True)
class Look:
    """How one series is drawn.

    Parameters
    ----------
    label : str
        Its name for a reader.
    colour : str
        From the palette of Okabe and Ito, or grey; `line` and `marker` are further cues beside it.
    line : str or tuple
        Line style of matplotlib.
    marker : str
        Marker of matplotlib.
    """

    label: str
    colour: str
    line: Any = "-"
    marker: str = "o"


INPUT_LOOKS: Mapping[str, Look] = {
    name: Look(INPUT_TITLES[name], *look)
    for name, look in {
        "standard": ("#8b919b", ":", "s"),
        "generalized": ("#cc79a7", (0, (1, 1)), "v"),
        "snn": ("#0072b2", "--", "D"),
        "adalam": ("#009e73", (0, (5, 1)), "P"),
        "gms": ("#56b4e9", (0, (3, 1, 1, 1)), "X"),
        "paper": ("#e69f00", "-.", "^"),
        "default": ("#d55e00", "-", "o"),
    }.items()
}
RANKING_LOOKS: Mapping[str, Look] = {
    name: Look(RANKING_TITLES[name], *look)
    for name, look in {
        "lowe": ("#8b919b", ":", "s"),
        "blogs": ("#56b4e9", "--", "D"),
        "2keypoint": ("#009e73", "-.", "v"),
        "sfm": ("#e69f00", (0, (5, 1)), "^"),
        "final": ("#d55e00", "-", "o"),
    }.items()
}

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8b919b", "#2b2f36")
Sharing = bool | Literal["row", "col"]


@contextmanager
def styled(
    rows: int, columns: int, size: tuple[float, float], *, sharex: Sharing = False, sharey: Sharing = False
) -> Iterator[tuple[Figure, list[list[Axes]]]]:
    """Yield a figure of `rows` x `columns` axes in the common style; save it inside.

    Parameters
    ----------
    rows, columns : int
        Axes.
    size : tuple of float
        Width and height, inches.
    sharex, sharey : bool, or "row" or "col"
        Which axes have the same limits.
    """
    with mpl.rc_context(_RC):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
        yield figure, [list(row) for row in axes]


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG, or a JPEG for photographs, without metadata that would change from one installation to the next."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".jpg":
        figure.savefig(path, pil_kwargs={"quality": 88})
    else:
        figure.savefig(path, metadata={"Software": None})
    return path


def legend(figure: Figure, looks: Sequence[Look], *, markers: bool = False, more: Sequence[Any] = ()) -> None:
    """Put one legend for all axes above them, with the markers of the series if these are drawn; `more` are handles."""
    handles = []
    for look in looks:
        marker = look.marker if markers else ""
        handles.append(Line2D([], [], color=look.colour, linestyle=look.line, marker=marker, ms=5, label=look.label))
    handles += more
    rows = -(-len(handles) // 7)  # more do not fit side by side
    figure.legend(handles=handles, loc="outside upper center", ncols=-(-len(handles) // rows), handlelength=2.6)


def look_of(looks: Mapping[str, Look], name: str, index: int) -> Look:
    """Return the look of a known series, or one from the palette for another."""
    return looks.get(name) or Look(name, SERIES[index % len(SERIES)])
