"""Details of walls: windows, doors and shop fronts, which repeat, and what is found once: posters, signs, stains."""

import cv2
import numpy as np
from numpy.random import Generator

from epiprior_lab.scenes.textures import crop, jittered, letters, noise
from epiprior_lab.scenes.world import Colour, Image

DUPLEX = cv2.FONT_HERSHEY_DUPLEX
LINTELS = ("none", "band", "keystone", "pediment", "arch", "carved")
GLASS = 128
Area = tuple[int, int, int, int]  # left, top, right, bottom
_SOLID = 255


class WindowStyle:
    """What all windows of a house share; `variety`, in [0, 1], tells how much one differs from the next."""

    def __init__(self, rng: Generator, wall_colour: Colour, *, variety: float) -> None:
        frames = ((235, 232, 225), (96, 66, 44), (60, 66, 72), (222, 214, 196), (46, 72, 60))
        r, g, b = (min(245.0, 1.22 * c) for c in wall_colour)
        trims = ((r, g, b), (206, 198, 180), (150, 140, 128), (232, 228, 220))
        shutters = ((70, 92, 72), (110, 60, 48), (72, 84, 110), (130, 118, 98))
        trim = trims[int(rng.integers(len(trims)))]
        self.width_m, self.height_m = rng.uniform(0.9, 1.6), rng.uniform(1.3, 2.1)
        self.columns, self.rows = int(rng.choice((2, 2, 2, 3, 4))), int(rng.choice((1, 2, 2, 3, 4)))
        self.frame_colour = jittered(rng, frames[int(rng.integers(len(frames)))], 0.08)
        self.trim_colour = jittered(rng, trim, 0.06)
        self.shutter_colour = jittered(rng, shutters[int(rng.integers(len(shutters)))], 0.15)
        self.frame_m = rng.uniform(0.05, 0.09)
        self.lintel = LINTELS[int(rng.integers(len(LINTELS)))]
        self.shutters = rng.random() < 0.25
        self.variety = variety


def draw_panes(rng: Generator, area: Image, style: WindowStyle, *, texels_per_m: float) -> None:
    """Draw a window into an area (H, W, 4): room, curtains, blind, frame; opacity tells glass from solid."""
    height, width = area.shape[:2]
    dark = rng.uniform(24, 52) + style.variety * rng.uniform(-14, 30)
    shade = np.linspace(1.3, 0.7, height, dtype=np.float32)[:, None, None]
    area[..., :3] = np.clip(np.array((0.95, 1.0, 1.08), dtype=np.float32) * dark * shade, 0, 255)
    area[..., 3] = int(GLASS + rng.uniform(0, 70))
    if rng.random() < 0.85:
        room = crop(rng, height, width, part=(0.15, 0.5))
        weight = rng.uniform(0.15, 0.25 + 0.5 * style.variety)
        area[..., :3] = cv2.addWeighted(area[..., :3], 1 - weight / 2, room, weight, 0)
    _draw_curtains(rng, area, style)
    frame = max(2, round(style.frame_m * texels_per_m))
    tone = 1.0 + style.variety * rng.uniform(-0.10, 0.06)
    colour = (*(int(min(255, c * tone)) for c in style.frame_colour), _SOLID)
    for k in range(1, style.columns):
        x = round(k * width / style.columns)
        bar = frame if 2 * k == style.columns else max(1, frame // 2)
        area[:, x - bar // 2 : x - bar // 2 + bar] = colour
    for k in range(1, style.rows):
        y = round(k * height / style.rows)
        bar = max(1, frame // 2)
        area[y : y + bar] = colour
        area[min(y + bar, height - 1)] = [*(int(0.5 * c) for c in colour[:3]), _SOLID]
    cv2.rectangle(area, (0, 0), (width - 1, height - 1), colour, frame)
    inner = (*(int(0.45 * c) for c in colour[:3]), _SOLID)
    cv2.rectangle(area, (frame, frame), (width - 1 - frame, height - 1 - frame), inner, 1)
    area[: max(2, height // 14), :, :3] //= 2  # the shadow of the reveal above


def _draw_curtains(rng: Generator, area: Image, style: WindowStyle) -> None:
    """Draw curtains and a blind, or neither, behind the glass."""
    height, width = area.shape[:2]
    kind = rng.choice(("none", "sides", "full", "blind", "sides+blind"), p=(0.3, 0.28, 0.1, 0.22, 0.1))
    tone = np.array(jittered(rng, (196, 188, 172), 0.1 + 0.25 * style.variety), dtype=np.float32)
    folds = 1.0 + 0.22 * np.sin(np.arange(width) * rng.uniform(0.25, 0.8) + rng.uniform(0, 6))
    cloth = np.clip(folds[None, :, None] * tone, 0, 255).astype(np.uint8)
    if kind.startswith("sides"):
        part = int(width * rng.uniform(0.12, 0.3))
        for columns in (slice(0, part), slice(width - part - int(rng.integers(0, 4)), width)):
            sheet = np.repeat(cloth[:, columns], height, 0)
            area[:, columns, :3] = cv2.addWeighted(area[:, columns, :3], 0.3, sheet, 0.7, 0)
    if kind == "full":
        area[..., :3] = cv2.addWeighted(area[..., :3], 0.35, np.repeat(cloth, height, 0), 0.65, 0)
    if kind.endswith("blind"):
        down = int(height * rng.uniform(0.15, 0.85))
        area[:down, :, :3] = tone
        area[:down:4, :, :3] = 0.72 * tone
        area[max(0, down - 2) : down, :, :3] = 0.4 * tone


def draw_trim(
    rng: Generator, wall: Image, opening: Area, style: WindowStyle, carving: Image | None, scale: float
) -> None:
    """Draw the stone around an opening of a wall (H, W, 4), shutters, and dirt below, at `scale` texels per metre."""
    left, top, right, bottom = opening
    band = max(3, round(0.14 * scale))
    colour = (*style.trim_colour, _SOLID)
    edge = (*(0.62 * c for c in style.trim_colour), _SOLID)
    if style.lintel != "none":
        cv2.rectangle(wall, (left - band, top - band), (right + band, bottom + band), edge, -1)
        cv2.rectangle(wall, (left - band + 1, top - band + 1), (right + band - 1, bottom + band - 1), colour, -1)
        cv2.rectangle(wall, (left - band // 3, top - band // 3), (right + band // 3, bottom + band // 3), edge, 1)
    middle, high, half = (left + right) // 2, top - band, band // 2
    key = [(middle - band, high - band), (middle + band, high - band), (middle + half, top), (middle - half, top)]
    gable = [(left - 2 * band, high), (middle, high - 3 * band), (right + 2 * band, high)]
    if style.lintel in ("keystone", "pediment"):
        corners, rim = (key, 1) if style.lintel == "keystone" else (gable, max(1, band // 3))
        cv2.fillPoly(wall, [np.array(corners, dtype=np.int32)], colour, cv2.LINE_AA)
        cv2.polylines(wall, [np.array(corners, dtype=np.int32)], True, edge, rim, cv2.LINE_AA)
    elif style.lintel == "arch":
        axes = ((right - left) // 2 + band, int(0.28 * (right - left)) + band)
        cv2.ellipse(wall, (middle, top), axes, 0, 180, 360, colour, -1, cv2.LINE_AA)
        cv2.ellipse(wall, (middle, top), axes, 0, 180, 360, edge, max(1, band // 4), cv2.LINE_AA)
    if carving is not None:
        paste(wall, carving, middle - carving.shape[1] // 2, high - carving.shape[0] - 1)
    if style.shutters:
        wide = max(4, (right - left) // 2)
        for x in (left - wide, right):
            own = jittered(rng, style.shutter_colour, 0.02 + 0.08 * style.variety)
            shutter = np.full((bottom - top, wide, 3), own, dtype=np.uint8)
            shutter[::5] //= 2
            cv2.rectangle(shutter, (0, 0), (wide - 1, bottom - top - 1), style.shutter_colour, max(2, wide // 12))
            paste(wall, shutter, x, top)
    if rng.random() < 0.3 + 0.5 * style.variety:
        sill = min(bottom + band, wall.shape[0] - 1)
        length = int(rng.uniform(0.3, 1.2) * scale)
        _draw_streaks(rng, wall[sill : sill + length, max(left, 0) : right, :3])


def paste(canvas: Image, patch: Image, left: int, top: int) -> None:
    """Copy a patch (H, W, 3) onto a canvas, cut at its rim."""
    height, width = canvas.shape[:2]
    x0, x1 = max(left, 0), min(left + patch.shape[1], width)
    y0, y1 = max(top, 0), min(top + patch.shape[0], height)
    if x0 < x1 and y0 < y1:
        canvas[y0:y1, x0:x1, :3] = patch[y0 - top : y1 - top, x0 - left : x1 - left]


def _draw_streaks(rng: Generator, area: Image) -> None:
    """Darken the wall below a sill in vertical streaks."""
    height, width = area.shape[:2]
    if min(height, width) < 2:
        return
    streaks = np.maximum(noise(rng, 1, width, "middle"), 0) * np.linspace(1, 0, height)[:, None]
    area[:] = area * (1 - np.clip(0.22 * streaks, 0, 0.5))[..., None]


def door(rng: Generator, height: int, width: int) -> Image:
    """Return a door or a shop window with its sign, shape (height, width, 4)."""
    image = np.full((height, width, 4), _SOLID, dtype=np.uint8)
    if rng.random() < 0.5:
        image[..., :3] = jittered(rng, (96, 70, 50), 0.4)
        relief = 1 + 0.12 * noise(rng, height, width, "middle")
        image[..., :3] = np.clip(image[..., :3] * relief[..., None], 0, 255)
        for y, x in np.ndindex(2, 2):
            corner = (int((0.1 + 0.45 * x) * width), int((0.08 + 0.46 * y) * height))
            other = (int((0.45 + 0.45 * x) * width), int((0.46 + 0.46 * y) * height))
            cv2.rectangle(image, corner, other, (40, 30, 24, _SOLID), max(1, width // 30))
        return image
    image[..., :3] = crop(rng, height, width, part=(0.4, 1.0)) // 2
    image[..., 3] = GLASS + 60
    sign = max(6, height // 6)
    image[:sign] = (*jittered(rng, (150, 60, 50), 0.5), _SOLID)
    name = "".join(chr(int(c)) for c in rng.integers(65, 91, size=max(3, width // sign)))
    at, ink = (3, int(0.8 * sign)), (240, 236, 220, _SOLID)
    cv2.putText(image, name, at, DUPLEX, sign / 34, ink, max(1, sign // 12), cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (60, 56, 52, _SOLID), max(2, width // 40))
    return image


def poster(rng: Generator, height: int, width: int) -> Image:
    """Return a poster: a picture, a border and lines of text, shape (height, width, 3)."""
    image = np.full((height, width, 3), jittered(rng, (206, 196, 176), 0.3), dtype=np.uint8)
    margin = max(2, min(height, width) // 18)
    bottom = int(height * rng.uniform(0.6, 0.95)) - margin
    picture = crop(rng, max(1, bottom - margin), max(1, width - 2 * margin))
    paste(image, picture, margin, margin)
    ink = tuple(int(c) for c in rng.integers(10, 90, size=3))
    size = max(0.3, width / 260)
    for y in range(bottom + int(22 * size), height - margin, max(4, int(26 * size))):
        cv2.putText(image, letters(rng, 14), (margin, y), DUPLEX, size, ink, max(1, int(size * 1.6)), cv2.LINE_AA)
    return image


def paint_details(rng: Generator, wall: Image, *, count: int, texels_per_m: float) -> None:
    """Put `count` random single things onto a wall (H, W, 4); its holes stay open."""
    height, width = wall.shape[:2]
    kinds = (_poster, _sign, _scrawl, _patch, _vent, _patch, _stain, _stain)
    for _ in range(count):
        y, x = int(rng.uniform(0.05, 0.95) * height), int(rng.uniform(0, 0.95) * width)
        kinds[int(rng.integers(len(kinds)))](rng, wall, x, y, texels_per_m)


def _poster(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    width = int(rng.uniform(0.4, 1.3) * scale)
    paste(wall, poster(rng, int(width * rng.uniform(0.8, 1.5)), width), x, y)


def _sign(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    height = int(rng.uniform(0.2, 0.5) * scale)
    width = int(height * rng.uniform(2, 6))
    sign = np.full((height, width, 3), jittered(rng, (120, 110, 100), 0.7), dtype=np.uint8)
    ink = (20, 20, 24) if sign.mean() > 110 else (236, 232, 214)
    at, triplex = (4, int(0.75 * height)), cv2.FONT_HERSHEY_TRIPLEX
    cv2.putText(sign, letters(rng, 10), at, triplex, height / 40, ink, max(1, height // 18), cv2.LINE_AA)
    cv2.rectangle(sign, (0, 0), (width - 1, height - 1), ink, max(1, height // 16))
    paste(wall, sign, x, y)


def _scrawl(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    """Sprayed strokes: Bezier curves of one colour."""
    colour = tuple(int(c) for c in rng.integers(20, 220, size=3))
    colours = np.ascontiguousarray(wall[..., :3])
    t = np.linspace(0, 1, 40)[:, None]
    for _ in range(int(rng.integers(2, 6))):
        p = rng.uniform(-0.8, 0.8, size=(4, 2)) * scale + (x, y)
        curve = (1 - t) ** 3 * p[0] + 3 * t * (1 - t) ** 2 * p[1] + 3 * t**2 * (1 - t) * p[2] + t**3 * p[3]
        cv2.polylines(colours, [curve.astype(np.int32)], False, colour, int(rng.integers(2, 6)), cv2.LINE_AA)
    wall[..., :3] = colours


def _patch(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    """Plaster of another tone, with a ragged rim."""
    width, height = int(rng.uniform(0.4, 2.0) * scale), int(rng.uniform(0.4, 2.0) * scale)
    area = wall[y : y + height, x : x + width, :3]
    height, width = area.shape[:2]
    if min(height, width) < 8:
        return
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    inside = (0.9 - np.maximum(np.abs(u), np.abs(v)) + 0.12 * noise(rng, height, width, "middle")) > 0
    tone = rng.uniform(0.65, 1.25) + 0.05 * noise(rng, height, width, "fine")
    area[:] = np.where(inside[..., None], np.clip(area * tone[..., None], 0, 255), area)


def _stain(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    """Damp or soot: dark, without a rim."""
    width, height = int(rng.uniform(0.3, 1.5) * scale), int(rng.uniform(0.5, 2.5) * scale)
    area = wall[y : y + height, x : x + width, :3]
    height, width = area.shape[:2]
    if min(height, width) < 8:
        return
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    density = np.clip(1.0 - u**2 - v**2 + 0.3 * noise(rng, height, width, "middle"), 0, 1)
    area[:] = area * (1 - rng.uniform(0.15, 0.45) * density[..., None])


def _vent(rng: Generator, wall: Image, x: int, y: int, scale: float) -> None:
    side = int(rng.uniform(0.2, 0.5) * scale)
    grille = np.full((side, side, 3), int(rng.uniform(90, 190)), dtype=np.uint8)
    grille[:: max(3, side // 8)] //= 3
    cv2.rectangle(grille, (0, 0), (side - 1, side - 1), (60, 60, 60), max(1, side // 12))
    paste(wall, grille, x, y)
