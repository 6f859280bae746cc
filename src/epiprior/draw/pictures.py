"""A picture of what was found: the best matches coloured by their probability, and epipolar lines.

Drawn with OpenCV alone. Points are pixels of the images as given, the centre of the top-left pixel at (0, 0).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from epiprior.draw.captions import Colour, Picture, draw_header, draw_label, probability_colours
from epiprior.draw.panels import SMALLEST_PANEL, Panel, blank_row, draw_dot, draw_epipolar_line, draw_line, lay_out
from epiprior.features.images import Image
from epiprior.io.output import PICTURES, check_output, replacing
from epiprior.presets import check_settings, in_range
from epiprior.types import FloatArray, FundamentalEstimate, IntArray, MatchSet

# Eight hues that stay apart on a darkened photograph, also for the colour-blind (after Okabe and Ito).
_HUES: tuple[Colour, ...] = (
    (240, 228, 66), (86, 180, 233), (255, 140, 60), (60, 200, 150),
    (240, 130, 200), (255, 255, 255), (120, 150, 255), (190, 240, 120),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class DrawSettings:
    """What is drawn, and how large; SettingsError for a number out of its range."""

    max_matches: int = in_range(1, math.inf, 100)  # number of best matches drawn, one per feature
    epipolar_lines: int = in_range(0, len(_HUES), 8)  # number of inliers whose epipolar lines are drawn
    max_panel_size: int = in_range(SMALLEST_PANEL, math.inf, 1024)  # longer side of each image; enlarged to 480 at most

    def __post_init__(self) -> None:
        check_settings(self)


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
    panels, shape = lay_out(image1, image2, settings.max_panel_size)
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
    check_output(path, PICTURES)
    _, data = cv2.imencode(path.suffix.lower(), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    with replacing(path) as partial:
        partial.write_bytes(data.tobytes())


def _scores(matches: MatchSet) -> tuple[FloatArray, str]:
    """Return a number in [0, 1] per match, the better the higher, and the name of what it shows."""
    if len(matches) and np.isnan(matches.probability).all():
        return 1.0 - np.clip(matches.distance_ratio, 0.0, 1.0), "1 - distance ratio"
    return np.clip(np.nan_to_num(matches.probability), 0.0, 1.0), "probability"


def _draw_match_row(
    panels: tuple[Panel, Panel], shape: tuple[int, int], matches: MatchSet, scores: FloatArray
) -> Picture:
    row = blank_row(panels, shape)
    visible = np.flatnonzero(panels[0].holds(matches.x1) & panels[1].holds(matches.x2))
    ends1, ends2, colours = (panels[0].place(matches.x1), panels[1].place(matches.x2), probability_colours(scores))
    lines = row.copy()
    # The worst first, so that the best lie on top.
    for i in visible[::-1]:
        draw_line(lines, ends1[i], ends2[i], colours[i], 1)
    row = np.asarray(cv2.addWeighted(lines, 0.75, row, 0.25, 0), dtype=np.uint8)
    for i in visible[::-1]:
        draw_dot(row, ends1[i], 2.5, colours[i])
        draw_dot(row, ends2[i], 2.5, colours[i])
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
    panels: tuple[Panel, Panel], shape: tuple[int, int], F: FloatArray, x1: FloatArray, x2: FloatArray
) -> Picture:
    row = blank_row(panels, shape)
    for panel, points, others, matrix in ((panels[0], x1, x2, F.T), (panels[1], x2, x1, F)):
        lines = np.column_stack([others, np.ones(len(others))]) @ matrix.T
        for colour, line in zip(_HUES, lines, strict=False):
            draw_epipolar_line(row, panel, line, colour)
        places = panel.place(points)
        for i in np.flatnonzero(panel.holds(points)):
            draw_dot(row, places[i], 4.5, _HUES[i])
    return row
