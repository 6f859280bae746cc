"""A list of pairs with text files of control points, homographies or fundamental matrices.

For the paper's sets ZuBuD, BLOGS, Open1, Open2 and Urban, and for anything else that comes as images and numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError, KnownSet, known_sets
from epiprior_lab.pairsets.files import read_matrix, read_table
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph
from epiprior_lab.pairsets.importers.text import read_rows, split_matches

TRUTHS = ("points", "homography", "fundamental")


def find_pairs(
    table: Path,
    *,
    images: Path | None = None,
    truths: Path | None = None,
    origin: float = 0.0,
    known: str | None = None,
) -> list[FoundPair]:
    """Return the pairs of a table.

    Parameters
    ----------
    table : Path
        Comma-separated, with columns ``image1, image2`` and at least one of ``points``, ``homography`` and
        ``fundamental``: files of text. Optional columns: ``points2`` (points of image 2 in a file of their own),
        ``pair_id``, ``difficulty``, ``scene`` (by default what `known` says, or the table's name). Files of points
        have rows ``x1 y1 x2 y2`` or ``x1 y1 1 x2 y2 1``; with ``points2``, rows ``x y`` or ``x y 1`` each.
    images, truths : Path, optional
        Folders that the names of images, and of the other files, are relative to; the table's by default.
    origin : float
        Coordinate of the centre of the top-left pixel in the files: 1 if they count as MATLAB does.
    known : str, optional
        Name of a known set: its number of pairs is checked, and it says what a scene is.

    Raises
    ------
    DatasetError
        If the table, an image or a file is missing or damaged, a row has no ground truth, or a known set has another
        number of pairs; the message names the file and line.
    """
    sets = {one.name: one for one in known_sets()}
    if known is not None and known not in sets:
        raise DatasetError(f"unknown set {known!r}; there are {', '.join(sets)}")
    chosen = None if known is None else sets[known]
    images, truths = images or table.parent, truths or table.parent
    pairs = []
    for line, row in read_table(table, ("image1", "image2")):
        pairs.append(_pair(row, (table, line), (images, truths), origin, chosen))
    if chosen is not None and len(pairs) != chosen.pairs:
        raise DatasetError(f"{table}: {len(pairs)} pairs, {chosen.title} has {chosen.pairs}")
    return pairs


def _pair(
    row: dict[str, str],
    place: tuple[Path, int],
    folders: tuple[Path, Path],
    origin: float,
    known: KnownSet | None,
) -> FoundPair:
    table, line = place
    images, truths = folders
    where = f"{table}, line {line}"
    photographs = []
    for column in ("image1", "image2"):
        path = images / row[column]
        if not row[column] or not path.is_file():
            raise DatasetError(f"{where}: no image {path}")
        # The folder is part of the name: images of several scenes may be called alike.
        name = "_".join(Path(row[column]).with_suffix("").parts)
        photographs.append(Photograph(name=name, path=path))
    files = {name: truths / row[name] for name in (*TRUTHS, "points2") if row.get(name)}
    if not any(name in files for name in TRUTHS):
        raise DatasetError(f"{where}: none of {', '.join(TRUTHS)} is given")
    if "homography" in files and "fundamental" in files:
        raise DatasetError(f"{where}: both a homography and a fundamental matrix are given")
    names = [photograph.name for photograph in photographs]
    scene = row.get("scene") or (known.scene(Path(row["image1"]).stem) if known else table.stem)
    shift = np.array([[1.0, 0.0, origin], [0.0, 1.0, origin], [0.0, 0.0, 1.0]])
    H, F = (read_matrix(files[name]) if name in files else None for name in ("homography", "fundamental"))
    return FoundPair(
        pair_id=row.get("pair_id") or f"{names[0]}_{names[1]}",
        scene=scene,
        image1=photographs[0],
        image2=photographs[1],
        difficulty=row.get("difficulty", ""),
        points=_points(files, origin) if "points" in files else None,
        homography=None if H is None else np.linalg.inv(shift) @ H @ shift,
        fundamental=None if F is None else shift.T @ F @ shift,
    )


def _points(files: dict[str, Path], origin: float) -> tuple[FloatArray, FloatArray]:
    """Return control points of one file, or of one file per image."""
    if "points2" not in files:
        x1, x2 = split_matches(read_rows(files["points"], (4, 6))[0])
    else:
        x1, x2 = (_single(files[name]) for name in ("points", "points2"))
        if len(x1) != len(x2):
            raise DatasetError(f"{files['points']} has {len(x1)} points, {files['points2']} {len(x2)}")
    return np.ascontiguousarray(x1 - origin), np.ascontiguousarray(x2 - origin)


def _single(path: Path) -> FloatArray:
    rows, _ = read_rows(path, (2, 3))
    return rows[:, :2] if rows.shape[1] == 2 else np.asarray(rows[:, :2] / rows[:, 2:])
