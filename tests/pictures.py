"""Small pictures made from scratch, for tests that need photographs."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


def texture(width: int = 480, height: int = 360, seed: int = 0) -> NDArray[np.uint8]:
    """Noise on several scales, uint8 (H, W): hundreds of distinct SIFT features."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width), np.float32)
    for cell in (4, 8, 16, 32):
        noise = rng.normal(size=(height // cell + 2, width // cell + 2)).astype(np.float32)
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)


def smooth(seed: int, sigma: float = 2.0, width: int = 480, height: int = 360) -> NDArray[np.uint8]:
    """A texture as smooth as a photograph."""
    return np.asarray(cv2.GaussianBlur(texture(width, height, seed), (0, 0), sigma), dtype=np.uint8)


def relief_pair(width: int = 480, height: int = 360, seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Two views of a wavy textured surface from cameras side by side: rows correspond."""
    left = texture(width, height, seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    disparity = 25 + 12 * np.sin(x / 45) * np.cos(y / 40) + 8 * np.sin(y / 23)
    right = cv2.remap(left, x + disparity, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return left, np.asarray(right, dtype=np.uint8)


def save(path: Path, picture: NDArray[np.uint8]) -> Path:
    assert cv2.imwrite(str(path), picture if picture.ndim == 2 else picture[:, :, ::-1])
    return path


def rotated(image, angle_deg):
    """Turn an image clockwise on the screen, onto a canvas that holds it; also return the map of points."""
    h, w = image.shape
    side = int(np.hypot(h, w)) + 2
    A = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), -angle_deg, 1.0)
    A[:, 2] += ((side - 1) / 2 - (w - 1) / 2, (side - 1) / 2 - (h - 1) / 2)
    return cv2.warpAffine(image, A, (side, side), flags=cv2.INTER_CUBIC, borderValue=128), A


def turned_jpeg(path: Path) -> Path:
    """Write a picture of 64 x 48 pixels that its EXIF orientation turns by a quarter."""
    data = cv2.imencode(".jpg", texture(64, 48))[1].tobytes()
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    return path
