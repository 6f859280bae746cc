"""Contact sheet: a few pairs of every family, side by side."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from epiprior_lab.pairsets import DatasetError, Pair
from epiprior_lab.report.style import INK, MUTED, save, styled
from epiprior_lab.scenes.world import Image

_THUMBNAIL = (384, 288)
_GAP = 8
_PANEL_INCHES = (3.6, 1.78)
_ROLL = re.compile(r"roll=(-?\d+)deg")


def contact_sheet(pair_sets: Mapping[str, Sequence[Pair]], path: Path) -> Path:
    """Draw the pairs of every family in rows of a figure, with what makes them easy or hard below each.

    Parameters
    ----------
    pair_sets : mapping of str to sequence of Pair
        Pairs to show by the name of their family; all families the same number, or fewer.
    path : Path
        PNG or JPEG file; its folder is made if absent.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    DatasetError
        If there is no pair to show, or an image cannot be read.
    """
    columns = max((len(pairs) for pairs in pair_sets.values()), default=0)
    if not columns:
        raise DatasetError(f"{path}: no pairs for a contact sheet")
    across = min(columns, 4)
    rows_of = {family: -(-len(pairs) // across) for family, pairs in pair_sets.items()}
    size = _PANEL_INCHES[0] * across, _PANEL_INCHES[1] * sum(rows_of.values())
    with styled(sum(rows_of.values()), across, size) as (figure, axes):
        first = 0
        for family, pairs in pair_sets.items():
            cells = [cell for row in axes[first : first + rows_of[family]] for cell in row]
            for k, cell in enumerate(cells):
                cell.set_axis_off()
                if k < len(pairs):
                    cell.imshow(_side_by_side(pairs[k]), interpolation="none")
                    cell.set_title(family if k == 0 else " ", fontsize=11, color=INK)
                    cell.text(
                        0.5,
                        -0.03,
                        _caption(pairs[k]),
                        transform=cell.transAxes,
                        ha="center",
                        va="top",
                        fontsize=8,
                        color=MUTED,
                    )
            first += rows_of[family]
        _tighten(figure)
        return save(figure, path)


def _tighten(figure: Figure) -> None:
    """Leave little room between panels."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(w_pad=0.04, h_pad=0.05, wspace=0.01, hspace=0.02)  # type: ignore[call-arg]


def _side_by_side(pair: Pair) -> Image:
    """Return small copies of both images, with a white gap between them."""
    parts = [
        _thumbnail(pair.image1),
        np.full((_THUMBNAIL[1], _GAP, 3), 255, dtype=np.uint8),
        _thumbnail(pair.image2),
    ]
    return np.hstack(parts)


def _thumbnail(path: Path) -> Image:
    """Return an image at the size of the sheet, RGB, padded with white to its shape."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise DatasetError(f"{path}: cannot be read as an image")
    width, height = _THUMBNAIL
    scale = min(width / image.shape[1], height / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:height, :width, ::-1]
    padded = np.full((height, width, 3), 255, dtype=np.uint8)
    top, left = (height - small.shape[0]) // 2, (width - small.shape[1]) // 2
    padded[top : top + small.shape[0], left : left + small.shape[1]] = small
    return padded


def _caption(pair: Pair) -> str:
    """Return what makes a pair easy or hard, for a reader; a roll from -179 to 180 degrees."""
    turned = _ROLL.sub(lambda found: f"roll={(int(found[1]) + 179) % 360 - 179}deg", pair.difficulty)
    parts = [part.replace("=", " ").replace("deg", "°") for part in turned.split(";") if part]
    return "   ".join(parts) or pair.pair_id
