"""Two photographs side by side, and what is drawn on them: lines, dots, epipolar lines.

Drawn with OpenCV alone. Points are pixels of the images as given, the centre of the top-left pixel at (0, 0).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.draw.captions import INK, PAPER, Colour, Picture
from epiprior.features.images import Image, check_pixels, read_image
from epiprior.types import FloatArray

SMALLEST_PANEL = 480
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Panel:
    """One image, or a part of it, as it stands in a row of the figure: pixels, their place, and the scale to them."""

    pixels: Picture
    left: int
    top: int
    factor: float
    size: tuple[int, int]
    origin: tuple[int, int] = (0, 0)  # of the part, pixels of the image as given

    def place(self, points: FloatArray) -> FloatArray:
        """Map pixels of the image as given to pixels of the row."""
        return (points - self.origin + 0.5) * self.factor - 0.5 + [self.left, self.top]

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return which points of the image as given lie in what is shown; NaN does not."""
        inside = (points >= np.array(self.origin) - 0.5) & (points <= np.add(self.origin, self.size) - 0.5)
        return np.asarray(inside.all(axis=1))


def read_rgb(image: Image) -> Picture:
    """Return an image as uint8 RGB, (H, W, 3); ImageError for anything that is none."""
    if isinstance(image, np.ndarray):
        check_pixels(image)
        return np.ascontiguousarray(image[..., :3] if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2))
    return np.asarray(cv2.cvtColor(read_image(image, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def lay_out(image1: Image, image2: Image, largest: int) -> tuple[tuple[Panel, Panel], tuple[int, int]]:
    """Scale both images to one height where their shapes allow it; return them and the shape of a row."""
    pictures = read_rgb(image1), read_rgb(image2)
    sizes = [np.array(picture.shape[1::-1], dtype=float) for picture in pictures]
    factors = [min(max(size.max(), SMALLEST_PANEL), largest) / size.max() for size in sizes]
    height = max(SMALLEST_PANEL // 2, min(f * size[1] for f, size in zip(factors, sizes, strict=True)))
    factors = [min(f, height / size[1]) for f, size in zip(factors, sizes, strict=True)]
    scaled = [dimmed(picture, factor) for picture, factor in zip(pictures, factors, strict=True)]
    gap = 8
    columns = [max(picture.shape[1], SMALLEST_PANEL // 2) for picture in scaled]
    row_height = max(picture.shape[0] for picture in scaled)
    spare = max(0, 2 * SMALLEST_PANEL - sum(columns)) // 2
    lefts = (spare, spare + columns[0] + gap)
    panels = []
    for picture, left, column, factor, size in zip(scaled, lefts, columns, factors, sizes, strict=True):
        x, y = left + (column - picture.shape[1]) // 2, (row_height - picture.shape[0]) // 2
        panels.append(Panel(picture, x, y, factor, (int(size[0]), int(size[1]))))
    return (panels[0], panels[1]), (row_height, sum(columns) + gap + 2 * spare)


def dimmed(image: Picture, factor: float) -> Picture:
    """Scale an image, and make it darker and greyer, so that coloured lines stand out on it."""
    height, width = image.shape[:2]
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    scaled = cv2.resize(image, size, interpolation=method).astype(np.float32)
    grey = scaled.mean(axis=2, keepdims=True)
    # A bright photograph is darkened more than a dark one.
    gain = float(np.clip(85.0 / max(float(grey.mean()), 1.0), 0.5, 1.0))
    return np.asarray(np.clip((0.35 * scaled + 0.65 * grey) * gain, 0, 255), dtype=np.uint8)


def blank_row(panels: Sequence[Panel], shape: tuple[int, int]) -> Picture:
    """Return a row of the figure with its images and nothing drawn on them."""
    row = np.full((*shape, 3), PAPER, np.uint8)
    for panel in panels:
        height, width = panel.pixels.shape[:2]
        row[panel.top : panel.top + height, panel.left : panel.left + width] = panel.pixels
    return row


def draw_line(picture: Picture, start: FloatArray, end: FloatArray, colour: Colour, thickness: int) -> None:
    """Draw a line between two points, in pixels of the picture."""
    ends = np.rint(np.array([start, end]) * 2**_SUBPIXEL_BITS).astype(int).tolist()
    cv2.line(picture, ends[0], ends[1], colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def draw_dot(picture: Picture, centre: FloatArray, radius: float, colour: Colour) -> None:
    """Draw a disc with a dark rim."""
    place = np.rint(np.asarray(centre) * 2**_SUBPIXEL_BITS).astype(int).tolist()
    for extra, paint in ((1.25, INK), (0.0, colour)):
        size = round((radius + extra) * 2**_SUBPIXEL_BITS)
        cv2.circle(picture, place, size, paint, -1, cv2.LINE_AA, _SUBPIXEL_BITS)


def draw_epipolar_line(row: Picture, panel: Panel, line: FloatArray, colour: Colour) -> None:
    """Draw a x + b y + c = 0, (3,), given in pixels of the image as given, where it crosses a panel of the row."""
    height, width = panel.pixels.shape[:2]
    # A view: the line ends at the border of its image.
    view, factor = row[panel.top : panel.top + height, panel.left : panel.left + width], panel.factor
    normal = line[:2]
    length = float(np.linalg.norm(normal))
    if length == 0:
        return
    normal = normal / length
    # The line in pixels of the view: x = (x' + 0.5) / factor - 0.5 + origin.
    offset = (line[2] / length + float(normal @ panel.origin) - 0.5 * normal.sum()) * factor + 0.5 * normal.sum()
    centre = np.array(view.shape[1::-1]) / 2.0
    distance = float(normal @ centre + offset)
    reach = float(np.linalg.norm(view.shape[:2]))
    if abs(distance) > reach:
        return
    foot = centre - distance * normal
    along = reach * np.array([-normal[1], normal[0]])
    draw_line(view, foot - along, foot + along, INK, 4)
    draw_line(view, foot - along, foot + along, colour, 2)
