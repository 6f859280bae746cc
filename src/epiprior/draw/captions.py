"""The words and the colour scale of a figure of `epiprior.draw.pictures`."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.types import FloatArray, FundamentalEstimate

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

PAPER: Colour = (255, 255, 255)
INK: Colour = (28, 28, 32)
_FAINT: Colour = (105, 105, 112)
_GOOD: Colour = (20, 120, 60)
_BAD: Colour = (185, 40, 40)


def probability_colours(scores: FloatArray) -> list[Colour]:
    """Map [0, 1] to viridis, RGB, without its darkest quarter, which is hard to see on a dark photograph."""
    if not len(scores):
        return []
    index = np.rint(64 + 191 * np.asarray(scores)).astype(np.uint8).reshape(-1, 1)
    bgr = cv2.applyColorMap(index, cv2.COLORMAP_VIRIDIS)[:, 0].tolist()
    return [(red, green, blue) for blue, green, red in bgr]


def draw_label(width: int, text: str) -> Picture:
    """Return a strip of `width` pixels with one line of text."""
    unit = _unit(width)
    strip = _strip(30 * unit, width)
    _write(strip, text, (10 * unit, 21 * unit), 0.5 * unit, _FAINT, room=width - 20 * unit)
    return strip


def draw_title(width: int, title: str, detail: str, scale_name: str) -> Picture:
    """Return a strip above a figure: a title and a line below it on the left, the colour scale on the right."""
    strip, room, unit = _headed(width, scale_name)
    _write(strip, title, (10 * unit, 28 * unit), 0.7 * unit, INK, room=room, bold=True)
    _write(strip, detail, (10 * unit, 52 * unit), 0.5 * unit, _FAINT, room=room)
    return strip


def draw_table(width: int, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Picture:
    """Return a strip with a table: the first column to the left, the others below the ends of their headings."""
    unit = _unit(width)
    strip = _strip((24 * (1 + len(rows)) + 14) * unit, width)
    size, gap = 0.45 * unit, 10 * unit
    step = (width - 2 * gap) / (len(header) + 1)  # the first column is twice as wide
    for line, cells in enumerate([header, *rows]):
        baseline, colour = (20 + 24 * line) * unit, INK if line else _FAINT
        for k, text in enumerate(cells):
            left = gap + (k + 2) * step - _width(text, size) if k else gap
            _write(strip, text, (left, baseline), size, colour, room=(1 if k else 2) * step)
    return strip


def draw_header(width: int, estimate: FundamentalEstimate | None, matches: int, scale_name: str) -> Picture:
    """Return the strip above the figure: what was estimated on the left, the colour scale on the right."""
    if estimate is None:
        return draw_title(width, f"{matches} matches", "", scale_name)
    strip, room, unit = _headed(width, scale_name)
    top, left = 28 * unit, 10 * unit
    end = _write(strip, f"{estimate.estimator}: ", (left, top), 0.7 * unit, INK, room=room / 2, bold=True) + 6 * unit
    colour = _GOOD if estimate else _BAD
    end = _write(strip, estimate.status.value, (end, top), 0.7 * unit, colour, room=room - end, bold=True) + 20 * unit
    sure = f"confidence {estimate.confidence:.2f}, " if np.isfinite(estimate.confidence) else ""
    support = f"{sure}support {estimate.support} of {len(estimate.x1)} matches"
    _write(strip, support, (end, top), 0.6 * unit, INK, room=room - end)
    facts = (f"geometry {estimate.geometry.value}", f"roll {estimate.roll_deg:.0f} deg", estimate.version)
    detail = ",  ".join(part for part in (estimate.message, *facts) if part)
    _write(strip, detail, (left, 52 * unit), 0.5 * unit, _FAINT, room=room)
    return strip


def _headed(width: int, scale_name: str) -> tuple[Picture, float, float]:
    """Return a strip with the colour scale on its right, the room left of that, and the unit of the lettering."""
    unit = _unit(width)
    strip = _strip(64 * unit, width)
    bar, margin = round(240 * unit), round(20 * unit)
    _draw_scale(strip[:, width - bar - margin : width - margin], scale_name, unit)
    return strip, width - bar - 2 * margin - 10 * unit, unit


def _unit(width: int) -> float:
    """Lettering grows with the figure, so that it stays readable when the figure is shown smaller."""
    return float(np.clip(width / 1250, 1.0, 2.0))


def _strip(height: float, width: int) -> Picture:
    return np.full((round(height), width, 3), PAPER, np.uint8)


def _draw_scale(area: Picture, name: str, unit: float) -> None:
    """Draw the colours from 0 to 1, their ends and what they stand for into `area`."""
    width = area.shape[1]
    top, bottom, baseline, size = round(14 * unit), round(28 * unit), 47 * unit, 0.5 * unit
    area[top:bottom] = np.array(probability_colours(np.linspace(0, 1, width)), np.uint8)
    cv2.rectangle(area, (0, top), (width - 1, bottom - 1), _FAINT, 1)
    for text, anchor in (("0", 0.0), (name, 0.5), ("1", 1.0)):
        _write(area, text, (anchor * (width - _width(text, size)), baseline), size, _FAINT, room=width)


def _width(text: str, size: float, bold: bool = False) -> int:
    font = cv2.FONT_HERSHEY_DUPLEX if bold else cv2.FONT_HERSHEY_SIMPLEX
    return int(cv2.getTextSize(text, font, size, 1)[0][0])


def _write(
    picture: Picture,
    text: str,
    at: tuple[float, float],
    size: float,
    colour: Colour,
    *,
    room: float,
    bold: bool = False,
) -> float:
    """Write a line of text, its baseline from `at`, shortened to `room` pixels; return where it ends."""
    left, baseline = at
    shown = text
    while shown and _width(shown, size, bold) > room:
        shown = shown[:-4] + "..." if len(shown) > 4 else ""
    font = cv2.FONT_HERSHEY_DUPLEX if bold else cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(picture, shown, (round(left), round(baseline)), font, size, colour, 1, cv2.LINE_AA)
    return left + _width(shown, size, bold)
