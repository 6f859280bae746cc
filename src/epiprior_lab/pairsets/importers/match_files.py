"""Sets with a file of matches per pair, ``name<ending>``; images ``nameA.ext`` and ``nameB.ext`` beside it or within.

The readme files of these sets do not say where the centre of the top-left pixel is; (0, 0) is our choice.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.types import BoolArray, FloatArray
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers import sources
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, Pixels

_ON_A_PLANE = 0.9
_PLANE_PX = 3.0


# Points (N, 2) of both images, labels (N,) where some matches are wrong (0), and the images where the file has them.
_Matches = tuple[FloatArray, FloatArray, NDArray[np.generic] | None, list[Pixels] | None]


def _read_validation(path: Path) -> _Matches:
    """``validation.pts``, 6 x N: homogeneous points of A above those of B."""
    points = getattr(sources.read_mat(path).get("validation"), "pts", None)
    if points is None:
        raise DatasetError(f"{path}: holds no validation.pts")
    x1, x2 = sources.matches_of_mat(path, points, "validation.pts")
    return x1, x2, None, None


def _read_labelled_mat(path: Path) -> _Matches:
    """``img1``, ``img2``, ``data`` (6 x N: x1 y1 1 x2 y2 1), ``score`` and ``label``."""
    content = sources.read_mat(path)
    missing = [name for name in ("img1", "img2", "data", "label") if name not in content]
    if missing:
        raise DatasetError(f"{path}: holds no {missing[0]}")
    x1, x2 = sources.matches_of_mat(path, content["data"], "data")
    labels = np.ravel(content["label"])
    if len(labels) != len(x1):
        raise DatasetError(f"{path}: {len(labels)} labels for {len(x1)} matches")
    return x1, x2, labels, [_bgr(path, content[name], name) for name in ("img1", "img2")]


def _read_labelled_text(path: Path) -> _Matches:
    """Rows ``x1 y1 1 x2 y2 1 label``."""
    rows = sources.read_rows(path, (7,))
    return *sources.split_matches(rows), rows[:, 6], None


_VALIDATION = "_vpts.mat"
# What each set may consist of, in order of preference: the end of the file's name, and its reader.
MATCH_FILES: dict[str, dict[str, Callable[[Path], _Matches]]] = {
    # kusvod2 and homogr of the Czech Technical University: control points by hand.
    "kusvod2": {_VALIDATION: _read_validation},
    # AdelaideRMF: SIFT matches labelled by hand, 0 for wrong ones and 1, 2, ... for the planes of a scene. Labelled
    # text is what other repositories pass on; kusvod2 is passed on so too, with labels 1 for points by hand.
    "adelaidermf": {".mat": _read_labelled_mat, "_pts.txt": _read_labelled_text},
}


def find_match_files(name: str, folder: Path, *, origin: float = 0.0) -> list[FoundPair]:
    """Return the pairs of a folder that holds one of `MATCH_FILES`.

    Pixels in the files are less by `origin` in the pairs: 1 if they count as MATLAB does. DatasetError names a missing
    folder or image, a damaged file, or one in which no match is labelled as right.
    """
    pairs: dict[str, FoundPair] = {}
    for ending, read in MATCH_FILES[name].items():
        for path in sources.files_of(folder, f"*{ending}"):
            stem = path.name.removesuffix(ending)
            if stem not in pairs and (ending == _VALIDATION or not path.name.endswith(_VALIDATION)):
                pairs[stem] = _pair(path, stem, read(path), origin)
    if not pairs:
        raise DatasetError(f"{folder}: no file {' or '.join(f'*{ending}' for ending in MATCH_FILES[name])}")
    return list(pairs.values())


def _pair(path: Path, name: str, found: _Matches, origin: float) -> FoundPair:
    x1, x2, labels, pixels = found
    difficulty = f"{len(x1)} manual points"
    if labels is not None:
        right = np.asarray(labels, dtype=np.float64) > 0
        if not right.any():
            raise DatasetError(f"{path}: no match is labelled as right")
        x1, x2, planes = x1[right], x2[right], len(np.unique(labels[right]))
        difficulty = f"{right.sum()} labelled matches, {planes} {'plane' if planes == 1 else 'planes'}"
        if _on_one_plane(x1, x2).mean() > _ON_A_PLANE:
            difficulty += "; all on one plane: they decide no F"
    names = name + "A", name + "B"
    if pixels is None:
        image1, image2 = (Photograph(name=one, path=sources.image_of(path.parent, one, path)) for one in names)
    else:
        develop = (partial(np.copy, own) for own in pixels)
        image1, image2 = (Photograph(name=one, path=path / one, develop=next(develop)) for one in names)
    points = np.ascontiguousarray(x1 - origin), np.ascontiguousarray(x2 - origin)
    return FoundPair(pair_id=name, scene=name, image1=image1, image2=image2, difficulty=difficulty, points=points)


def _on_one_plane(x1: FloatArray, x2: FloatArray) -> BoolArray:
    """Return which matches agree with the homography that most agree with."""
    if len(x1) < 5:
        return np.ones(len(x1), dtype=bool)
    mask = cv2.findHomography(np.ascontiguousarray(x1), np.ascontiguousarray(x2), cv2.RANSAC, _PLANE_PX)[1]
    return np.zeros(len(x1), dtype=bool) if mask is None else np.asarray(mask.ravel() > 0)


def _bgr(path: Path, value: object, name: str) -> Pixels:
    """Return an RGB or grey image of a MATLAB file as OpenCV orders colours."""
    pixels = np.asarray(value)
    if pixels.dtype != np.uint8 or pixels.ndim not in {2, 3} or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise DatasetError(f"{path}: {name} is no 8-bit image, but {pixels.dtype} of shape {pixels.shape}")
    return np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, ::-1])
