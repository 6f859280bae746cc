"""AdelaideRMF: SIFT matches labelled by hand, 0 for wrong ones and 1, 2, ... for the planes of a scene.

Format (its own readme): a ``name.mat`` holds ``img1``, ``img2``, ``data`` (6 x N: x1 y1 1 x2 y2 1), ``score`` and
``label``. Labelled text is what other repositories pass on: ``name_pts.txt`` with rows ``x1 y1 1 x2 y2 1 label``
beside the images ``nameA.ext`` and ``nameB.ext``; kusvod2 is passed on so too, with labels 1 for points by hand.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.images_beside import image_of, need_folder
from epiprior_lab.pairsets.importers.matlab import matches, read_mat
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, Pixels
from epiprior_lab.pairsets.importers.text import read_rows, split_matches

_TEXT_ENDING = "_pts.txt"
_ON_A_PLANE = 0.9
_PLANE_PX = 3.0


def find_adelaidermf(folder: Path, *, origin: float = 0.0) -> list[FoundPair]:
    """Return the pairs of a folder with ``*.mat`` or ``*_pts.txt``; a name that has both is read from ``.mat``.

    Parameters
    ----------
    folder : Path
        Folder of the files.
    origin : float
        Coordinate of the centre of the top-left pixel in the files; its readme does not say, 0 is our choice.

    Raises
    ------
    DatasetError
        If the folder or an image is missing, a file is damaged, or none of its matches is labelled as right.
    """
    pairs = {}
    for path in sorted(need_folder(folder).glob("*.mat")):
        if not path.name.endswith("_vpts.mat"):
            pairs[path.stem] = _from_mat(path, origin)
    for path in sorted(folder.glob(f"*{_TEXT_ENDING}")):
        name = path.name.removesuffix(_TEXT_ENDING)
        if name not in pairs:
            pairs[name] = _from_text(path, name, origin)
    if not pairs:
        raise DatasetError(f"{folder}: neither a .mat file nor a *{_TEXT_ENDING}")
    return list(pairs.values())


def _from_mat(path: Path, origin: float) -> FoundPair:
    content = read_mat(path)
    missing = [name for name in ("img1", "img2", "data", "label") if name not in content]
    if missing:
        raise DatasetError(f"{path}: holds no {missing[0]}")
    x1, x2 = matches(path, content["data"], "data")
    labels = np.ravel(content["label"])
    if len(labels) != len(x1):
        raise DatasetError(f"{path}: {len(labels)} labels for {len(x1)} matches")
    photographs = []
    for side, name in (("A", "img1"), ("B", "img2")):
        pixels = _bgr(path, content[name], name)
        photographs.append(Photograph(name=path.stem + side, path=path / name, develop=partial(np.copy, pixels)))
    return _pair(path, path.stem, (x1 - origin, x2 - origin), labels, (photographs[0], photographs[1]))


def _from_text(path: Path, name: str, origin: float) -> FoundPair:
    rows, _ = read_rows(path, (7,))
    x1, x2 = split_matches(rows)
    image1, image2 = (Photograph(name=name + side, path=image_of(path.parent, name + side, path)) for side in "AB")
    return _pair(path, name, (x1 - origin, x2 - origin), rows[:, 6], (image1, image2))


def _pair(
    path: Path,
    name: str,
    points: tuple[FloatArray, FloatArray],
    labels: NDArray[np.generic],
    images: tuple[Photograph, Photograph],
) -> FoundPair:
    right = np.asarray(labels, dtype=np.float64) > 0
    if not right.any():
        raise DatasetError(f"{path}: no match is labelled as right")
    planes = len(np.unique(labels[right]))
    x1, x2 = (np.ascontiguousarray(x[right]) for x in points)
    difficulty = f"{right.sum()} labelled matches, {planes} {'plane' if planes == 1 else 'planes'}"
    if _on_one_plane(x1, x2).mean() > _ON_A_PLANE:
        difficulty += "; all on one plane: they decide no F"
    return FoundPair(
        pair_id=name, scene=name, image1=images[0], image2=images[1], difficulty=difficulty, points=(x1, x2)
    )


def _on_one_plane(x1: FloatArray, x2: FloatArray) -> BoolArray:
    """Return which matches agree with the homography that most agree with."""
    import cv2

    if len(x1) < 5:
        return np.ones(len(x1), dtype=bool)
    mask = cv2.findHomography(x1, x2, cv2.RANSAC, _PLANE_PX)[1]
    return np.zeros(len(x1), dtype=bool) if mask is None else np.asarray(mask.ravel() > 0)


def _bgr(path: Path, value: object, name: str) -> Pixels:
    """Return an RGB or grey image of a MATLAB file as OpenCV orders colours."""
    pixels = np.asarray(value)
    if pixels.dtype != np.uint8 or pixels.ndim not in {2, 3} or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise DatasetError(f"{path}: {name} is no 8-bit image, but {pixels.dtype} of shape {pixels.shape}")
    return np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, ::-1])
