"""What is infinitely far: sky, clouds and skyline; glass reflects it."""

from __future__ import annotations

import cv2
import numpy as np

from epiprior_lab.scenes.textures import crop, noise
from epiprior_lab.scenes.world import Image

_ROWS, _COLUMNS = 512, 1024


def draw_surroundings(rng: np.random.Generator) -> Image:
    """Return a picture of all directions, (512, 1024, 3): zenith in the first row, horizon in the middle."""
    half = _ROWS // 2
    zenith = np.array(((92, 130, 186), (150, 160, 172), (118, 148, 190))[int(rng.integers(3))], dtype=np.float32)
    horizon = np.array((206, 212, 216), dtype=np.float32)
    part = np.linspace(0, 1, half, dtype=np.float32)[:, None, None] ** 1.5
    sky = np.repeat(zenith * (1 - part) + horizon * part, _COLUMNS, axis=1)
    clouds = cv2.GaussianBlur(np.ascontiguousarray(noise(rng, half, _COLUMNS, "coarse")), (0, 0), 2.0)
    cover = np.clip(rng.uniform(-0.6, 0.5) + 0.7 * clouds, 0, 1)[..., None]
    sky = sky * (1 - 0.8 * cover) + 236 * 0.8 * cover
    ground = np.full((half, _COLUMNS, 3), 112, dtype=np.float32)
    image = np.concatenate([sky, ground])
    image[half - 40 : half + 10] = _skyline(rng, image[half - 40 : half + 10])
    return np.asarray(np.clip(image, 0, 255), dtype=np.uint8)


def _skyline(rng: np.random.Generator, band: np.ndarray) -> np.ndarray:
    """Draw the other side of the street, blurred: it is seen only as a reflection or behind everything."""
    height, width = band.shape[:2]
    out = np.array(band, dtype=np.float32)
    x = 0
    while x < width:
        wide, high = int(rng.integers(20, 80)), int(rng.integers(12, height - 8))
        view = crop(rng, height, wide, ("china", "rocket", "motorcycle", "camera"), part=(0.4, 1.0))
        part = out[height - high :, x : x + wide]
        part[:] = 0.35 * part + 0.5 * view[height - high :, : part.shape[1]]
        x += wide + int(rng.integers(0, 40))
    return np.asarray(cv2.GaussianBlur(out, (0, 0), 1.2))
