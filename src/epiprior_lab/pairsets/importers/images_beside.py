"""Finding the image that belongs to a name."""

from __future__ import annotations

from pathlib import Path

from epiprior_lab.pairsets import DatasetError

SUFFIXES = (".jpg", ".jpeg", ".png", ".ppm", ".pgm", ".bmp", ".tif", ".tiff")


def image_of(folder: Path, stem: str, wanted_by: Path) -> Path:
    """Return the one image ``<stem>.<suffix>`` of a folder, upper or lower case.

    Raises
    ------
    DatasetError
        If there is none or more than one; the message names `wanted_by`, the file that needs it.
    """
    found = sorted(path for path in folder.iterdir() if path.stem == stem and path.suffix.lower() in SUFFIXES)
    if not found:
        raise DatasetError(f"{wanted_by}: no image {folder / stem} with one of {', '.join(SUFFIXES)}")
    if len(found) > 1:
        raise DatasetError(f"{wanted_by}: both {found[0]} and {found[1].name} are there")
    return found[0]


def need_folder(path: Path) -> Path:
    """Return `path`, or raise DatasetError where it is no folder."""
    if not path.is_dir():
        raise DatasetError(f"{path}: no such folder")
    return path
