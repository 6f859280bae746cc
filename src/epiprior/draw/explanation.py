"""A picture of why a match has its probability: where it is, what holds it, the F that it supports, its columns."""

from dataclasses import replace

import cv2
import numpy as np

from epiprior.draw.captions import Colour, Picture, draw_label, draw_table, draw_title, probability_colours
from epiprior.draw.panels import Panel, blank_row, dimmed, draw_dot, draw_epipolar_line, draw_line, lay_out, read_rgb
from epiprior.explain import HEADER, Explanation
from epiprior.features.images import Image
from epiprior.types import FloatArray

_LINE: Colour = (255, 140, 60)
_FRAME: Colour = (255, 255, 255)
_PANEL_SIZE = 720  # longer side of each image, pixels
_PARTNERS = 40  # so many 2keypoints are drawn
_SMALLEST_REACH = 40.0  # pixels around the match that the closer look shows at least


def draw_explanation(image1: Image, image2: Image, explanation: Explanation) -> Picture:
    """Draw one match of two images and why it has its probability; RGB, (H, W, 3).

    From above: both images, with the match, a frame around what is shown below, and the epipolar lines of the best
    rough F that it supports; the part around the match, with lines to its partners in matches of 2keypoints; the
    columns that decide most. Images as for `draw_matches`, those that were explained; ImageError for others.
    """
    images = read_rgb(image1), read_rgb(image2)
    panels, shape = lay_out(*images, _PANEL_SIZE)
    width, e = shape[1], explanation
    rows = np.append(e.row, e.partners[:_PARTNERS])
    points = e.ranked.x1[rows], e.ranked.x2[rows]
    F = np.zeros((3, 3)) if e.best is None else e.best.F  # of no line
    lines = [matrix @ np.append(other[0], 1.0) for matrix, other in ((F.T, points[1]), (F, points[0]))]
    # What is hardly a 2keypoint may be far away; it may end outside.
    near = np.append(True, e.partner_probability[:_PARTNERS] >= 0.1 * e.partner_probability[:1])
    close = [_closer(panel, image, own[near]) for panel, image, own in zip(panels, images, points, strict=True)]
    held, supported, best, columns = e.sentences()
    detail = f"row {e.row} of {len(e.ranked)} at a roll of {e.ranked.roll_deg:.0f} deg"
    detail += f";  {supported}" if supported else ""
    whole = [_drawn(*each) for each in zip(panels, (e, e), points, lines, close, strict=True)]
    around = [_drawn(*each) for each in zip(close, (e, e), points, lines, strict=True)]
    title = draw_title(width, f"match {e.match}: probability {e.probability:.3g}", detail, "probability")
    first, second, third = (draw_label(width, sentence) for sentence in (best, held, columns))
    table = draw_table(width, HEADER, [column.cells() for column in e.rounds[-1].decisive()])
    return np.vstack([title, first, blank_row(whole, shape), second, blank_row(around, shape), third, table])


def _closer(panel: Panel, image: Picture, points: FloatArray) -> Panel:
    """Return the part of an image around the first point that shows all points, in the place of its panel."""
    size = np.array(panel.size)
    reach = max(1.15 * float(np.abs(points - points[0]).max()), _SMALLEST_REACH)
    window = np.minimum(np.ceil(2 * reach * size / size.min()), size).astype(int)
    x, y = np.clip(np.rint(points[0] - window / 2), 0, size - window).astype(int).tolist()
    factor = min(panel.pixels.shape[1] / window[0], panel.pixels.shape[0] / window[1])
    pixels = dimmed(np.ascontiguousarray(image[y : y + window[1], x : x + window[0]]), factor)
    return Panel(pixels, panel.left, panel.top, factor, (int(window[0]), int(window[1])), (x, y))


def _drawn(panel: Panel, e: Explanation, own: FloatArray, line: FloatArray, part: Panel | None = None) -> Panel:
    """Return a panel with the match and the epipolar line; and a frame around a part, or else the 2keypoints."""
    at_origin = replace(panel, left=0, top=0)
    picture, places = panel.pixels.copy(), at_origin.place(own)
    draw_epipolar_line(picture, at_origin, line, _LINE)
    if part:
        low, high = at_origin.place(np.array([part.origin, np.add(part.origin, part.size) - 1.0]))
        cv2.rectangle(picture, np.rint(low).astype(int).tolist(), np.rint(high).astype(int).tolist(), _FRAME, 1)
    else:
        partners = list(zip(places[1:], probability_colours(e.partner_probability[:_PARTNERS]), strict=True))
        for place, colour in reversed(partners):  # the best on top
            draw_line(picture, places[0], place, colour, 2)
            draw_dot(picture, place, 4.0, colour)
    draw_dot(picture, places[0], 7.0, _FRAME)
    draw_dot(picture, places[0], 4.5, probability_colours(np.array([e.probability]))[0])
    return replace(panel, pixels=picture)
