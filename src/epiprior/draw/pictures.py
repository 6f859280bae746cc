"""A picture of what was found: the best matches coloured by their probability, and epipolar lines.

Drawn with OpenCV alone. Points are pixels of the images as given, the centre of the top-left pixel at (0, 0).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.draw.captions import INK, PAPER, Colour, Picture, draw_header, draw_label, probability_colours
from epiprior.errors import ImageError, SettingsError
from epiprior.features.images import Image, read_image
from epiprior.types import FloatArray, FundamentalEstimate, IntArray, MatchSet

# Eight hues that stay apart on a darkened photograph, also for the colour-blind (after Okabe and Ito).
_HEX = (0xF0E442, 0x56B4E9, 0xFF8C3C, 0x3CC896, 0xF082C8, 0xFFFFFF, 0x7896FF, 0xBEF078)
_HUES: tuple[Colour, ...] = tuple((number >> 16, number >> 8 & 255, number & 255) for number in _HEX)
_SMALLEST_PANEL = 480
_SUBPIXEL_BITS = 4


@dataclass(frozen=True, kw_only=True)
class DrawSettings:
    """What is drawn, and how large; SettingsError for a number out of its range."""

    max_matches: int = 100  # number of best matches drawn, one per feature, >= 1
    epipolar_lines: int = 8  # number of inliers whose epipolar lines are drawn, in 0..8
    max_panel_size: int = 1024  # longer side of each image, pixels, >= 480; none is enlarged beyond 480

    def __post_init__(self) -> None:
        if self.max_matches < 1:
            raise SettingsError(f"max_matches is {self.max_matches}, must be at least 1")
        if not 0 <= self.epipolar_lines <= len(_HUES):
            raise SettingsError(f"epipolar_lines is {self.epipolar_lines}, must be in 0..{len(_HUES)}")
        if self.max_panel_size < _SMALLEST_PANEL:
            raise SettingsError(f"max_panel_size is {self.max_panel_size}, must be at least {_SMALLEST_PANEL}")


@dataclass(frozen=True)
class _Panel:
    """One image as it stands in a row of the figure: pixels, their place, and the scale to them."""

    pixels: Picture
    left: int
    top: int
    factor: float
    size: tuple[int, int]

    def place(self, points: FloatArray) -> FloatArray:
        """Map pixels of the image as given to pixels of the row."""
        return (points + 0.5) * self.factor - 0.5 + [self.left, self.top]

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return which points lie in the image as given; NaN does not."""
        inside = (points >= -0.5) & (points <= np.array(self.size) - 0.5)
        return np.asarray(inside.all(axis=1))


def draw_matches(
    image1: Image,
    image2: Image,
    matches: MatchSet,
    estimate: FundamentalEstimate | None = None,
    *,
    settings: DrawSettings | None = None,
) -> Picture:
    """Draw the best matches of two images and, under them, the epipolar lines of some inliers; RGB, (H, W, 3).

    Images are files, or uint8 arrays of shape (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, of any sizes; ImageError for
    others. `matches`, sorted best first, may be empty; they are coloured by probability, where that is NaN (standard
    matches) by the distance ratio. Status and support of `estimate` are written above; lines are drawn where it has F.
    """
    settings = settings or DrawSettings()
    panels, shape = _lay_out(_read_rgb(image1), _read_rgb(image2), settings.max_panel_size)
    width = shape[1]
    best = matches.one_to_one() if len(matches) else matches
    best = best.take(slice(settings.max_matches))
    scores, scale_name = _scores(best)
    rows = [
        draw_header(width, estimate, len(matches), scale_name),
        draw_label(width, f"{len(best)} best matches, coloured by {scale_name}"),
        _draw_match_row(panels, shape, best, scores),
    ]
    if estimate and estimate.F is not None and settings.epipolar_lines:
        chosen = np.flatnonzero(estimate.inliers)
        chosen = chosen[_spread(estimate.x1[chosen], settings.epipolar_lines)]
        rows += [
            draw_label(width, f"epipolar lines of {len(chosen)} inliers"),
            _draw_epipolar_row(panels, shape, estimate.F, estimate.x1[chosen], estimate.x2[chosen]),
        ]
    return np.vstack(rows)


def write_picture(path: Path, picture: Picture) -> None:
    """Write an RGB picture as PNG or JPEG, by the suffix of `path`; a file is replaced only as a whole.

    OutputError if the suffix is unknown or the file cannot be written; the message names the path.
    """
    from epiprior.io.output import PICTURES, check_output, replacing

    check_output(path, PICTURES)
    _, data = cv2.imencode(path.suffix.lower(), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    with replacing(path) as partial:
        partial.write_bytes(data.tobytes())


def _read_rgb(image: Image) -> Picture:
    if isinstance(image, np.ndarray):
        if image.dtype != np.uint8 or not image.size or image.shape[2:] not in ((), (3,), (4,)) or image.ndim < 2:
            raise ImageError(
                f"the image array is {image.dtype} of shape {image.shape}, "
                "expected uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, not empty"
            )
        return np.ascontiguousarray(image[..., :3] if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2))
    return np.asarray(cv2.cvtColor(read_image(image, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _lay_out(image1: Picture, image2: Picture, largest: int) -> tuple[tuple[_Panel, _Panel], tuple[int, int]]:
    """Scale both images to one height where their shapes allow it; return them and the shape of a row."""
    sizes = [np.array(image.shape[1::-1], dtype=float) for image in (image1, image2)]
    factors = [min(max(size.max(), _SMALLEST_PANEL), largest) / size.max() for size in sizes]
    height = max(_SMALLEST_PANEL // 2, min(f * size[1] for f, size in zip(factors, sizes, strict=True)))
    factors = [min(f, height / size[1]) for f, size in zip(factors, sizes, strict=True)]
    scaled = [_dimmed(image, factor) for image, factor in zip((image1, image2), factors, strict=True)]
    gap = 8
    columns = [max(picture.shape[1], _SMALLEST_PANEL // 2) for picture in scaled]
    row_height = max(picture.shape[0] for picture in scaled)
    spare = max(0, 2 * _SMALLEST_PANEL - sum(columns)) // 2
    lefts = (spare, spare + columns[0] + gap)
    panels = []
    for picture, left, column, factor, size in zip(scaled, lefts, columns, factors, sizes, strict=True):
        x, y = left + (column - picture.shape[1]) // 2, (row_height - picture.shape[0]) // 2
        panels.append(_Panel(picture, x, y, factor, (int(size[0]), int(size[1]))))
    return (panels[0], panels[1]), (row_height, sum(columns) + gap + 2 * spare)


def _dimmed(image: Picture, factor: float) -> Picture:
    """Scale an image, and make it darker and greyer, so that coloured lines stand out on it."""
    height, width = image.shape[:2]
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    scaled = cv2.resize(image, size, interpolation=method).astype(np.float32)
    grey = scaled.mean(axis=2, keepdims=True)
    # A bright photograph is darkened more than a dark one.
    gain = float(np.clip(85.0 / max(float(grey.mean()), 1.0), 0.5, 1.0))
    return np.asarray(np.clip((0.35 * scaled + 0.65 * grey) * gain, 0, 255), dtype=np.uint8)


def _scores(matches: MatchSet) -> tuple[FloatArray, str]:
    """Return a number in [0, 1] per match, the better the higher, and the name of what it shows."""
    if len(matches) and np.isnan(matches.probability).all():
        return 1.0 - np.clip(matches.distance_ratio, 0.0, 1.0), "1 - distance ratio"
    return np.clip(np.nan_to_num(matches.probability), 0.0, 1.0), "probability"


def _blank_row(panels: Sequence[_Panel], shape: tuple[int, int]) -> Picture:
    row = np.full((*shape, 3), PAPER, np.uint8)
    for panel in panels:
        height, width = panel.pixels.shape[:2]
        row[panel.top : panel.top + height, panel.left : panel.left + width] = panel.pixels
    return row


def _line(picture: Picture, start: FloatArray, end: FloatArray, colour: Colour, thickness: int) -> None:
    ends = np.rint(np.array([start, end]) * 2**_SUBPIXEL_BITS).astype(int).tolist()
    cv2.line(picture, ends[0], ends[1], colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _dot(picture: Picture, centre: FloatArray, radius: float, colour: Colour) -> None:
    place = np.rint(np.asarray(centre) * 2**_SUBPIXEL_BITS).astype(int).tolist()
    for extra, paint in ((1.25, INK), (0.0, colour)):
        size = round((radius + extra) * 2**_SUBPIXEL_BITS)
        cv2.circle(picture, place, size, paint, -1, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_match_row(
    panels: tuple[_Panel, _Panel], shape: tuple[int, int], matches: MatchSet, scores: FloatArray
) -> Picture:
    row = _blank_row(panels, shape)
    visible = np.flatnonzero(panels[0].holds(matches.x1) & panels[1].holds(matches.x2))
    ends1, ends2, colours = (panels[0].place(matches.x1), panels[1].place(matches.x2), probability_colours(scores))
    lines = row.copy()
    # The worst first, so that the best lie on top.
    for i in visible[::-1]:
        _line(lines, ends1[i], ends2[i], colours[i], 1)
    row = np.asarray(cv2.addWeighted(lines, 0.75, row, 0.25, 0), dtype=np.uint8)
    for i in visible[::-1]:
        _dot(row, ends1[i], 2.5, colours[i])
        _dot(row, ends2[i], 2.5, colours[i])
    return row


def _spread(points: FloatArray, count: int, among: int = 200) -> IntArray:
    """Choose up to `count` of the first `among` points, each the farthest from those chosen before."""
    points = points[:among]
    chosen: list[int] = []
    distance = np.full(len(points), np.inf)
    while len(chosen) < count and len(points) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)


def _draw_epipolar_row(
    panels: tuple[_Panel, _Panel], shape: tuple[int, int], F: FloatArray, x1: FloatArray, x2: FloatArray
) -> Picture:
    row = _blank_row(panels, shape)
    for panel, points, others, matrix in ((panels[0], x1, x2, F.T), (panels[1], x2, x1, F)):
        height, width = panel.pixels.shape[:2]
        # A view: lines end at the border of their image.
        view = row[panel.top : panel.top + height, panel.left : panel.left + width]
        lines = np.column_stack([others, np.ones(len(others))]) @ matrix.T
        for colour, line in zip(_HUES, lines, strict=False):
            _draw_infinite_line(view, line, panel.factor, colour)
        places = panel.place(points)
        for i in np.flatnonzero(panel.holds(points)):
            _dot(row, places[i], 4.5, _HUES[i])
    return row


def _draw_infinite_line(view: Picture, line: FloatArray, factor: float, colour: Colour) -> None:
    """Draw a x + b y + c = 0, given in pixels of the whole image, where it crosses `view`."""
    normal = line[:2]
    length = float(np.linalg.norm(normal))
    if length == 0:
        return
    normal = normal / length
    # The line in pixels of the view: x = (x' + 0.5) / factor - 0.5.
    offset = (line[2] / length - 0.5 * normal.sum()) * factor + 0.5 * normal.sum()
    centre = np.array(view.shape[1::-1]) / 2.0
    distance = float(normal @ centre + offset)
    reach = float(np.linalg.norm(view.shape[:2]))
    if abs(distance) > reach:
        return
    foot = centre - distance * normal
    along = reach * np.array([-normal[1], normal[0]])
    _line(view, foot - along, foot + along, INK, 4)
    _line(view, foot - along, foot + along, colour, 2)
