"""Image files: their size, from the header, and whether they can be decoded."""

from __future__ import annotations

from pathlib import Path

import cv2
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError

from epiprior_lab.pairsets.files import DatasetError

_ORIENTATION_TAG = 0x0112
_TURNED_BY_A_QUARTER = (5, 6, 7, 8)


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image as OpenCV decodes it: turned as its EXIF data say.

    Raises
    ------
    DatasetError
        If the file cannot be read or is no image.
    """
    try:
        with PillowImage.open(path) as image:
            width, height = image.size
            exif = PillowImage.Exif()
            exif.load(image.info.get("exif", b""))  # `getexif` would decode the pixels of a PNG file
            turned = exif.get(_ORIENTATION_TAG) in _TURNED_BY_A_QUARTER
    except UnidentifiedImageError as error:
        raise DatasetError(f"{path}: is no image") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as an image: {error}") from error
    return (height, width) if turned else (width, height)


def check_pixels(path: Path) -> None:
    """Decode an image.

    Raises
    ------
    DatasetError
        If OpenCV cannot decode it.
    """
    if cv2.imread(str(path), cv2.IMREAD_REDUCED_GRAYSCALE_8) is None:
        raise DatasetError(f"{path}: OpenCV cannot decode this image")
