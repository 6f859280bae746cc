"""Pairs of images with text files: of control points, homographies or F by a list, and the release of USAC.

The list is for the paper's sets ZuBuD, BLOGS, Open1, Open2 and Urban, and for anything else that comes as images and
numbers. USAC has a folder per pair with ``im1.jpg``, ``im2.jpg`` and ``orig_pts.txt``: the number of matches, then a
line ``x1 y1 x2 y2`` each. They are putative matches with many wrong ones, and no ground truth.
"""

from pathlib import Path

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError, KnownSet, known_sets
from epiprior_lab.pairsets.files import read_control_points, read_matrix, read_table
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of
from epiprior_lab.pairsets.importers.sources import files_of, read_rows, split_matches

TRUTHS = ("points", "homography", "fundamental")
_USAC_MATCHES = "orig_pts.txt"


def find_pairs(
    table: Path,
    *,
    images: Path | None = None,
    truths: Path | None = None,
    origin: float = 0.0,
    known: str | None = None,
) -> list[FoundPair]:
    """Return the pairs of a comma-separated table, whose columns are in ``docs/pair-sets.md``.

    Names of images and of other files are relative to `images` and `truths`, by default the table's folder. `origin` is
    the coordinate of the centre of the top-left pixel in the files: 1 if they count as MATLAB does. `known` is the name
    of a known set: its number of pairs is checked, and it says what a scene is. DatasetError, with file and line, if
    the table, an image or a file is missing or damaged, a row has no ground truth, or the number of pairs is wrong.
    """
    sets = {one.name: one for one in known_sets()}
    if known is not None and known not in sets:
        raise DatasetError(f"unknown set {known!r}; there are {', '.join(sets)}")
    chosen = sets[known] if known else None
    folders = images or table.parent, truths or table.parent
    pairs = [
        _listed(row, f"{table}, line {line}", folders, origin, chosen, table.stem)
        for line, row in read_table(table, ("image1", "image2"))
    ]
    if chosen is not None and len(pairs) != chosen.pairs:
        raise DatasetError(f"{table}: {len(pairs)} pairs, {chosen.title} has {chosen.pairs}")
    return pairs


def _listed(
    row: dict[str, str], where: str, folders: tuple[Path, Path], origin: float, known: KnownSet | None, scene: str
) -> FoundPair:
    images, truths = folders
    photographs = []
    for column in ("image1", "image2"):
        path = images / row[column]
        if not row[column] or not path.is_file():
            raise DatasetError(f"{where}: no image {path}")
        photographs.append(Photograph(name=name_of(row[column]), path=path))
    files = {name: truths / row[name] for name in (*TRUTHS, "points2") if row.get(name)}
    if not any(name in files for name in TRUTHS):
        raise DatasetError(f"{where}: none of {', '.join(TRUTHS)} is given")
    if "homography" in files and "fundamental" in files:
        raise DatasetError(f"{where}: both a homography and a fundamental matrix are given")
    image1, image2 = photographs
    shift = np.array([[1.0, 0.0, origin], [0.0, 1.0, origin], [0.0, 0.0, 1.0]])
    H, F = (read_matrix(files[name]) if name in files else None for name in ("homography", "fundamental"))
    return FoundPair(
        pair_id=row.get("pair_id") or f"{image1.name}_{image2.name}",
        scene=row.get("scene") or (known.scene(Path(row["image1"]).stem) if known else scene),
        image1=image1,
        image2=image2,
        difficulty=row.get("difficulty", ""),
        points=_points(files, origin) if "points" in files else None,
        homography=None if H is None else np.linalg.inv(shift) @ H @ shift,
        fundamental=None if F is None else shift.T @ F @ shift,
    )


def _points(files: dict[str, Path], origin: float) -> tuple[FloatArray, FloatArray]:
    """Return control points of one file, or of one file per image."""
    if "points2" not in files:
        x1, x2 = split_matches(read_rows(files["points"], (4, 6)))
    else:
        rows = [read_rows(files[name], (2, 3)) for name in ("points", "points2")]
        x1, x2 = (x if x.shape[1] == 2 else np.asarray(x[:, :2] / x[:, 2:]) for x in rows)
        if len(x1) != len(x2):
            raise DatasetError(f"{files['points']} has {len(x1)} points, {files['points2']} {len(x2)}")
    return np.ascontiguousarray(x1 - origin), np.ascontiguousarray(x2 - origin)


def find_usac(folder: Path, *, points: Path | None = None) -> list[FoundPair]:
    """Return the pairs of the USAC release in all folders below; the id of a pair is its folder's name.

    Control points by hand are in the folder `points`, ``<pair_id>.csv``. DatasetError if there are none for a pair,
    there is no pair, or a file is missing or damaged.
    """
    pairs = []
    for path in files_of(folder, f"**/{_USAC_MATCHES}"):
        pair_id = path.parent.resolve().name
        images = [path.parent / f"im{number}.jpg" for number in (1, 2)]
        for image in images:
            if not image.is_file():
                raise DatasetError(f"{path}: no image {image}")
        rows = read_rows(path, (4,))
        by_hand = (points or Path("POINTS")) / f"{pair_id}.csv"
        if points is None or not by_hand.is_file():
            raise DatasetError(
                f"{path}: its matches are no ground truth. Mark points with `epiprior-lab label {images[0]} {images[1]}"
                f" --out {by_hand}` and name their folder with --points"
            )
        one, two = (Photograph(name=f"{pair_id}_{k}", path=image) for k, image in enumerate(images, 1))
        text, known = f"points by hand; {len(rows)} matches", read_control_points(by_hand)
        pairs.append(FoundPair(pair_id=pair_id, scene=pair_id, image1=one, image2=two, difficulty=text, points=known))
    if not pairs:
        raise DatasetError(f"{folder}: no {_USAC_MATCHES} in it or below")
    return pairs
