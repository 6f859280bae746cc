"""What lens, sensor and file do to an image: exposure, tone, colour cast, vignetting, blur, noise, JPEG."""

import cv2
import numpy as np

from epiprior.types import Float32Array
from epiprior_lab.scenes.world import Image


def take(image: Image, rng: np.random.Generator) -> Image:
    """Return an image, shape (H, W, 3), as a camera would have delivered it."""
    height, width = image.shape[:2]
    warmth = float(rng.uniform(-0.06, 0.06))
    exposure = float(rng.uniform(82, 120))  # median brightness that the camera aims at, levels of 256
    gamma = float(rng.uniform(0.85, 1.2))
    vignetting = np.float32(rng.uniform(0.0, 0.2))  # loss of brightness in the corners
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 0.9))), dtype=np.uint8)
    noise = np.float32(rng.uniform(0.6, 2.5))  # a deviation, levels of 256
    tones = (np.arange(256) / 255.0) ** gamma * 255.0
    middle = max(float(np.median(tones[image[::8, ::8]])), 1.0)
    light = tones[:, None] * np.clip(exposure / middle, 0.6, 2.2) * np.array((1.0 + warmth, 1.0, 1.0 - warmth))
    # A soft shoulder instead of clipping: skies keep their tone.
    light = np.where(light > 220, 220 + 35 * (1 - np.exp(-(light - 220) / 35)), light)
    table = light.astype(np.float32).reshape(256, 1, 3)
    exposed: Float32Array = np.asarray(cv2.LUT(image, table), dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, width, dtype=np.float32)[None]
    exposed *= (1 - vignetting * (x * x + y * y) / 2)[..., None]
    # One grain for all channels: what a real camera leaves after demosaicing is mostly noise of brightness.
    grains = rng.standard_normal((height, width), dtype=np.float32)
    exposed += (noise * grains)[..., None]
    return np.asarray(np.clip(exposed + 0.5, 0, 255).astype(np.uint8))


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Return an RGB image as the bytes of a JPEG file of a quality in 1 to 100."""
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()
