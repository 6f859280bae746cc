"""The photographs of a collection: found, named as COLMAP names them, and checked before any work.

COLMAP does not turn an image by its EXIF orientation; nor is it turned here, so that coordinates are the same.
"""

import hashlib
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from epiprior.errors import ImageError
from epiprior.features.images import is_hidden_copy, read_image
from epiprior.io.colmap import colmap_name, is_turned
from epiprior.types import BoolArray

_logger = logging.getLogger(__name__)
_SUFFIXES = frozenset([".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp", ".pgm", ".ppm", ".pnm", ".jp2"])
_MOST_NAMED = 5


@dataclass(frozen=True, kw_only=True)
class CollectionImage:
    """A photograph of a collection."""

    name: str  # what COLMAP calls it: its path relative to the folder of the collection, with slashes
    path: Path | None  # None where only its features are known
    mask: Path | None = None  # a picture that is black where nothing is looked for; None: everywhere is looked
    digest: str = ""  # SHA-256 of the bytes of the file and of the mask; empty without a file


@dataclass(frozen=True, kw_only=True)
class ImageSet:
    """The photographs of a collection, by name, and the files that were left out, each with the reason."""

    root: Path
    images: tuple[CollectionImage, ...]
    left_out: tuple[tuple[str, str], ...] = ()


def find_images(
    given: str | Path | Sequence[str | Path], *, mask_path: str | Path | None = None, known: Sequence[str] = ()
) -> ImageSet:
    """Find and check the photographs of a collection.

    `given` is a folder, which is searched with its subfolders for files that are called like images, or image files and
    folders. Names are relative to the folder, or to the deepest that holds all. `mask_path` is a folder of masks,
    called as COLMAP calls them: ``NAME.png`` or NAME with ``.png`` for its suffix. Every photograph needs one, of its
    size. `known` are names in `given`, a folder, to take instead of all that are found there.

    ImageError if a photograph or mask is missing, unreadable, given twice or of another size, a name is not UTF-8, or
    fewer than two are left; the message names them.
    """
    places = [Path(given)] if isinstance(given, str | Path) else [Path(place) for place in given]
    root, files, left_out = _files(places, known)
    masks = None if mask_path is None else Path(mask_path)
    if masks is not None and not masks.is_dir():
        raise ImageError(f"{masks}: no such folder of masks")
    images: list[CollectionImage] = []
    turned: list[str] = []
    bad: list[str] = []
    first_of: dict[str, str] = {}
    for path in files:
        try:
            image, by_exif = _checked(root, path, masks)
        except ImageError as error:
            bad.append(str(error))
            continue
        if image.digest in first_of and not known:
            left_out.append((image.name, f"the same bytes as {first_of[image.digest]}"))
            continue
        first_of[image.digest] = image.name
        images.append(image)
        turned += [image.name] * by_exif
    if bad:
        more = f"; and {len(bad) - _MOST_NAMED} more" if len(bad) > _MOST_NAMED else ""
        raise ImageError("; ".join(bad[:_MOST_NAMED]) + more)
    for name, why in left_out:
        _logger.warning("left out %s: %s", name, why)
    if turned:
        _logger.warning(
            "%d images have an EXIF orientation, which is ignored as COLMAP does: %s", len(turned), turned[0]
        )
    if len(images) < 2:
        raise ImageError(f"{', '.join(map(str, places))}: {len(images)} images, at least two are needed")
    return ImageSet(root=root, images=tuple(images), left_out=tuple(left_out))


def known_images(names: Sequence[str], folder: Path | None, file: Path) -> ImageSet:
    """Return the images whose features a `file` holds, by name; `folder` holds their photographs, if at hand."""
    called = sorted(names)
    if folder is not None:
        return find_images(folder, known=called)
    return ImageSet(root=file.parent, images=tuple(CollectionImage(name=name, path=None) for name in called))


def read_mask(path: Path) -> BoolArray:
    """Return where a mask is not black, (H, W)."""
    return np.asarray(read_image(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION) > 0)


def _files(places: Sequence[Path], known: Sequence[str]) -> tuple[Path, list[Path], list[tuple[str, str]]]:
    """Return the folder that names are relative to, the files by name, and what is left out at once."""
    # Links stay links: an image is named as the user names it, wherever its bytes are.
    places = [Path(os.path.abspath(place)) for place in places]  # noqa: PTH100
    folders = [place for place in places if place.is_dir()]
    parents = [place if place in folders else place.parent for place in places]
    root = Path(os.path.commonpath(parents)) if parents else Path.cwd()
    if known:
        if len(folders) != len(places) or len(places) != 1:
            raise ImageError(f"{', '.join(map(str, places))}: one folder is needed, the one that names are relative to")
        return root, [root / name for name in known], []
    found = [place for place in places if place not in folders]
    for place, below, names in (step for folder in folders for step in os.walk(folder, followlinks=True)):
        below[:] = sorted(name for name in below if not name.startswith("."))
        found += [path for name in sorted(names) if (path := Path(place) / name).suffix.lower() in _SUFFIXES]
    hidden = [path for path in found if is_hidden_copy(path.name)]
    found = [path for path in found if not is_hidden_copy(path.name)]
    if len(set(found)) < len(found):
        raise ImageError(f"{next(path for path in found if found.count(path) > 1)}: is given twice")
    left_out = [(str(path), f"one of {len(hidden)} files named ._*, which hold no image") for path in hidden[:1]]
    return root, sorted(found, key=lambda path: path.relative_to(root).as_posix()), left_out


def _checked(root: Path, path: Path, masks: Path | None) -> tuple[CollectionImage, bool]:
    """Return a photograph, and whether its EXIF orientation would turn it; ImageError if it cannot be used."""
    name, turned = colmap_name(path, root), is_turned(path)
    digest, mask = hashlib.sha256(path.read_bytes()), None
    if masks is not None:
        choices = (masks / f"{name}.png", (masks / name).with_suffix(".png"))
        mask = next((choice for choice in choices if choice.is_file()), None)
        if mask is None:
            raise ImageError(f"{path}: has no mask {choices[0]}")
        full = read_image(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION).shape
        if (shape := read_mask(mask).shape) != full:
            raise ImageError(f"{mask}: is {shape[1]} x {shape[0]}, its image {full[1]} x {full[0]}")
        digest.update(mask.read_bytes())
    return CollectionImage(name=name, path=path, mask=mask, digest=digest.hexdigest()), turned
