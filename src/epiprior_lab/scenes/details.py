"""What is found once on a wall: posters, signs, scrawls, patches of other plaster, stains, vents."""

import cv2
import numpy as np

from epiprior_lab.scenes.materials import jittered
from epiprior_lab.scenes.textures import DUPLEX, PICTURES, crop, letters, noise
from epiprior_lab.scenes.windows import paste
from epiprior_lab.scenes.world import Image


def poster(rng: np.random.Generator, height: int, width: int) -> Image:
    """Return a poster: a picture, a border and lines of text, shape (height, width, 3)."""
    image = np.full((height, width, 3), jittered(rng, (206, 196, 176), 0.3), dtype=np.uint8)
    margin = max(2, min(height, width) // 18)
    bottom = int(height * rng.uniform(0.6, 0.95)) - margin
    picture = crop(rng, max(1, bottom - margin), max(1, width - 2 * margin), PICTURES)
    paste(image, picture, margin, margin)
    ink = tuple(int(c) for c in rng.integers(10, 90, size=3))
    size = max(0.3, width / 260)
    for y in range(bottom + int(22 * size), height - margin, max(4, int(26 * size))):
        cv2.putText(image, letters(rng, 14), (margin, y), DUPLEX, size, ink, max(1, int(size * 1.6)), cv2.LINE_AA)
    return image


def paint_details(rng: np.random.Generator, wall: Image, *, count: int, texels_per_m: float) -> None:
    """Put `count` random single things onto a wall (H, W, 4); its holes stay open."""
    height, width = wall.shape[:2]
    kinds = (_poster, _sign, _scrawl, _patch, _vent, _patch, _stain, _stain)
    for _ in range(count):
        y, x = int(rng.uniform(0.05, 0.95) * height), int(rng.uniform(0, 0.95) * width)
        kinds[int(rng.integers(len(kinds)))](rng, wall, x, y, texels_per_m)


def _poster(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
    width = int(rng.uniform(0.4, 1.3) * scale)
    paste(wall, poster(rng, int(width * rng.uniform(0.8, 1.5)), width), x, y)


def _sign(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
    height = int(rng.uniform(0.2, 0.5) * scale)
    width = int(height * rng.uniform(2, 6))
    sign = np.full((height, width, 3), jittered(rng, (120, 110, 100), 0.7), dtype=np.uint8)
    ink = (20, 20, 24) if sign.mean() > 110 else (236, 232, 214)
    at, triplex = (4, int(0.75 * height)), cv2.FONT_HERSHEY_TRIPLEX
    cv2.putText(sign, letters(rng, 10), at, triplex, height / 40, ink, max(1, height // 18), cv2.LINE_AA)
    cv2.rectangle(sign, (0, 0), (width - 1, height - 1), ink, max(1, height // 16))
    paste(wall, sign, x, y)


def _scrawl(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
    """Sprayed strokes: Bezier curves of one colour."""
    colour = tuple(int(c) for c in rng.integers(20, 220, size=3))
    colours = np.ascontiguousarray(wall[..., :3])
    t = np.linspace(0, 1, 40)[:, None]
    for _ in range(int(rng.integers(2, 6))):
        p = rng.uniform(-0.8, 0.8, size=(4, 2)) * scale + (x, y)
        curve = (1 - t) ** 3 * p[0] + 3 * t * (1 - t) ** 2 * p[1] + 3 * t**2 * (1 - t) * p[2] + t**3 * p[3]
        cv2.polylines(colours, [curve.astype(np.int32)], False, colour, int(rng.integers(2, 6)), cv2.LINE_AA)
    wall[..., :3] = colours


def _patch(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
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


def _stain(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
    """Damp or soot: dark, without a rim."""
    width, height = int(rng.uniform(0.3, 1.5) * scale), int(rng.uniform(0.5, 2.5) * scale)
    area = wall[y : y + height, x : x + width, :3]
    height, width = area.shape[:2]
    if min(height, width) < 8:
        return
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    density = np.clip(1.0 - u**2 - v**2 + 0.3 * noise(rng, height, width, "middle"), 0, 1)
    area[:] = area * (1 - rng.uniform(0.15, 0.45) * density[..., None])


def _vent(rng: np.random.Generator, wall: Image, x: int, y: int, scale: float) -> None:
    side = int(rng.uniform(0.2, 0.5) * scale)
    grille = np.full((side, side, 3), int(rng.uniform(90, 190)), dtype=np.uint8)
    grille[:: max(3, side // 8)] //= 3
    cv2.rectangle(grille, (0, 0), (side - 1, side - 1), (60, 60, 60), max(1, side // 12))
    paste(wall, grille, x, y)
