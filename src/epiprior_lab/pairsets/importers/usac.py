"""The test pairs of the USAC release: a folder per pair with ``im1.jpg``, ``im2.jpg`` and ``orig_pts.txt``.

``orig_pts.txt`` has the number of matches, then a line ``x1 y1 x2 y2`` each. They are putative matches with many wrong
ones, and no ground truth: the authors of the paper marked 16 points per pair by hand.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_control_points
from epiprior_lab.pairsets.importers.images_beside import need_folder
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph
from epiprior_lab.pairsets.importers.text import read_rows

_MATCHES = "orig_pts.txt"
_IMAGES = ("im1.jpg", "im2.jpg")
_FIT_PX = 1.0
_MOST_POINTS = 200


def find_usac(folder: Path, *, points: Path | None = None, fit: bool = False) -> list[FoundPair]:
    """Return the pairs of a release, found in all folders below.

    Parameters
    ----------
    folder : Path
        For example its ``data/fundmatrix``.
    points : Path, optional
        Folder of ``<pair_id>.csv``, control points by hand as ``epiprior-lab label`` writes them. A pair's id is its
        folder's name.
    fit : bool
        Where there are no points by hand, take the matches of the release that agree with the F which OpenCV's
        MAGSAC++ fits to them. Such pairs are called "fitted" in ``difficulty``: an estimator made their ground truth,
        so they must not decide between estimators.

    Raises
    ------
    DatasetError
        If there is no pair, a file is missing or damaged, or a pair has no control points and `fit` is False.
    """
    pairs = []
    for path in sorted(need_folder(folder).rglob(_MATCHES)):
        images = [path.parent / name for name in _IMAGES]
        for image in images:
            if not image.is_file():
                raise DatasetError(f"{path}: no image {image}")
        pair_id = path.parent.resolve().name
        rows, _ = read_rows(path, (4,))
        by_hand = None if points is None else points / f"{pair_id}.csv"
        if by_hand is not None and by_hand.is_file():
            known, difficulty = read_control_points(by_hand), "points by hand"
        elif fit:
            known, difficulty = _agreeing(path, rows), "fitted to the matches of the release"
        else:
            wanted = by_hand or Path("POINTS") / f"{pair_id}.csv"
            raise DatasetError(
                f"{path}: its matches are no ground truth. Mark points with `epiprior-lab label {images[0]} {images[1]}"
                f" --out {wanted}` and name their folder with --points, or let --fit derive them"
            )
        photographs = [Photograph(name=f"{pair_id}_{number}", path=image) for number, image in enumerate(images, 1)]
        pairs.append(
            FoundPair(
                pair_id=pair_id,
                scene=pair_id,
                image1=photographs[0],
                image2=photographs[1],
                difficulty=f"{difficulty}; {len(rows)} matches",
                points=known,
            )
        )
    if not pairs:
        raise DatasetError(f"{folder}: no {_MATCHES} in it or below")
    return pairs


def _agreeing(path: Path, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at most 200 matches within a pixel of the F that MAGSAC++ fits to all."""
    found = None
    if len(rows) >= 8:
        parameters = cv2.UsacParams()
        parameters.confidence, parameters.maxIterations, parameters.threshold = 0.9999, 100_000, 1.5
        parameters.score, parameters.sampler = cv2.SCORE_METHOD_MAGSAC, cv2.SAMPLING_UNIFORM
        parameters.loMethod, parameters.randomGeneratorState = cv2.LOCAL_OPTIM_SIGMA, 0
        found = cv2.findFundamentalMat(
            np.ascontiguousarray(rows[:, :2]), np.ascontiguousarray(rows[:, 2:]), parameters
        )[0]
    if found is None or np.shape(found) != (3, 3):
        raise DatasetError(f"{path}: no F can be fitted to its {len(rows)} matches")
    near = rows[sampson_distance(np.asarray(found), rows[:, :2], rows[:, 2:]) < _FIT_PX]
    if len(near) < 8:
        raise DatasetError(f"{path}: only {len(near)} of {len(rows)} matches agree with the F fitted to them")
    kept = near[np.unique(np.linspace(0, len(near) - 1, min(_MOST_POINTS, len(near))).astype(int))]
    return np.ascontiguousarray(kept[:, :2]), np.ascontiguousarray(kept[:, 2:])
