"""Reader of a pair set: a folder with ``pairs.csv``, images, and what is true of each pair."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from epiprior.geometry import sampson_distance
from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.files import PAIR_COLUMNS, DatasetError, check_pixels, image_size, read_cameras, read_table
from epiprior_lab.pairsets.homographies import transfer_distance
from epiprior_lab.pairsets.pair import Pair

GROUND_TRUTHS = ("cameras", "control_points", "homography", "fundamental")
FIT_PX = 3.0
_MARGIN_PX = 2.0  # reprojected and hand-made points may lie a little outside


@dataclass(frozen=True, kw_only=True)
class PairSet:
    """The pairs of a folder, in the order of ``pairs.csv``; `name` is the name of the folder."""

    name: str
    pairs: tuple[Pair, ...]


def read_pair_set(root: Path | str, control_points: Path | str | None = None) -> PairSet:
    """Read a pair set and check it, in milliseconds per pair; `check_pair_set` reads depth maps and pixels too.

    `control_points` is the folder of ``<pair_id>.csv``, by default ``root/control_points``. DatasetError, with file and
    line, if the folder is no pair set, a file or camera is missing, a pair id is there twice, a value is wrong, an
    image has another size than its camera, a control point lies more than 2 px outside its image, or the median
    distance of the control points to what the cameras, a given F or a given homography say is above 3 px.
    """
    root = Path(root)
    points_folder = root / "control_points" if control_points is None else Path(control_points)
    if control_points is not None and not points_folder.is_dir():
        raise DatasetError(f"{points_folder}: no such folder of control points")
    table = root / "pairs.csv"
    rows = list(read_table(table, PAIR_COLUMNS))
    if not rows:
        raise DatasetError(f"{table}: no pair")
    given = any(row["gt"] == "cameras" for _, row in rows)
    cameras = read_cameras(root / "cameras.csv") if given else {}
    size_of = functools.cache(image_size)
    pairs: dict[str, Pair] = {}
    for line, row in rows:
        where, pair_id = f"{table}, line {line}", row["pair_id"]
        if pair_id in pairs or not pair_id:
            raise DatasetError(f"{where}: pair_id {pair_id!r} is empty or there twice")
        if Path(pair_id).name != pair_id:
            raise DatasetError(f"{where}: pair_id {pair_id!r} is no file name")
        if row["gt"] not in GROUND_TRUTHS:
            raise DatasetError(f"{where}: gt = {row['gt']!r}, expected one of {', '.join(GROUND_TRUTHS)}")
        pairs[pair_id] = _pair(root, row, points_folder / f"{pair_id}.csv", cameras, size_of, where)
    return PairSet(name=root.resolve().name, pairs=tuple(pairs.values()))


def check_pair_set(root: Path | str, *, on_pair: Callable[[], None] = lambda: None) -> PairSet:
    """Read a pair set, and then its depth maps and images too; `on_pair` is called after each pair.

    DatasetError as from `read_pair_set`, or if a depth map cannot be read; ImageError if an image cannot be decoded.
    """
    pair_set = read_pair_set(root)
    check_once = functools.cache(check_pixels)
    for pair in pair_set.pairs:
        pair.depths()
        for path in (pair.image1, pair.image2):
            check_once(path)
        on_pair()
    return pair_set


def _pair(
    root: Path,
    row: dict[str, str],
    points: Path,
    cameras: dict[str, Camera],
    size_of: Callable[[Path], tuple[int, int]],
    where: str,
) -> Pair:
    """Return the pair of a row, its files checked except depth maps and pixels."""
    names, gt, table = (row["image1"], row["image2"]), row["gt"], root / "cameras.csv"
    sizes = []
    for name in names:
        path = root / name
        if not path.is_file():
            raise DatasetError(f"{where}: no image {path}")
        width, height = size_of(path)
        sizes.append((width, height))
        if gt == "cameras" and name not in cameras:
            raise DatasetError(f"{where}: {table} has no camera of {name!r}")
        own = (cameras[name].width, cameras[name].height) if gt == "cameras" else (width, height)
        if own != (width, height):
            raise DatasetError(f"{where}: {path} is {width} x {height}, its camera in {table} {own[0]} x {own[1]}")
    matrix = root / gt / f"{row['pair_id']}.txt"
    for kind, path in (("control_points", points), ("homography", matrix), ("fundamental", matrix)):
        if gt == kind and not path.is_file():
            raise DatasetError(f"{where}: no {kind.replace('_', ' ')} {path}")
    depths = [root / "depth" / f"{Path(name).stem}.npz" for name in names]
    pair = Pair(
        pair_id=row["pair_id"],
        scene=row["scene"],
        image1=root / names[0],
        image2=root / names[1],
        camera1=cameras[names[0]] if gt == "cameras" else None,
        camera2=cameras[names[1]] if gt == "cameras" else None,
        difficulty=row["difficulty"],
        control_points_path=points if points.is_file() else None,
        depth_paths=(depths[0], depths[1]) if all(path.is_file() for path in depths) else None,
        homography_path=matrix if gt == "homography" else None,
        fundamental_path=matrix if gt == "fundamental" else None,
    )
    _check_truth(pair, sizes, where)
    return pair


def _check_truth(pair: Pair, sizes: list[tuple[int, int]], where: str) -> None:
    """Check that matrices can be read, and that control points lie in their images and fit the rest of the truth."""
    H, F = pair.homography(), pair.fundamental()
    path = pair.control_points_path
    if path is None:
        return
    x1, x2 = pair.control_points()
    for number, (x, size) in enumerate(zip((x1, x2), sizes, strict=True), 1):
        outside = np.flatnonzero(((x < -_MARGIN_PX) | (x > np.array(size) - 1 + _MARGIN_PX)).any(axis=1))
        if len(outside):
            row = int(outside[0])
            raise DatasetError(
                f"{path}, line {row + 2}: point {x[row, 0]:g}, {x[row, 1]:g} lies outside image {number}, "
                f"{size[0]} x {size[1]}"
            )
    if H is not None:
        distance, what = transfer_distance(H, x1, x2), f"the homography {pair.homography_path}"
    elif F is not None:
        given = "of the cameras" if pair.fundamental_path is None else str(pair.fundamental_path)
        distance, what = sampson_distance(F, x1, x2), f"the F {given}"
    else:
        return
    if len(distance) and not np.median(distance) <= FIT_PX:
        raise DatasetError(
            f"{where}: {what} of pair {pair.pair_id!r} does not fit its control points {path}: median distance "
            f"{np.median(distance):.1f} px, at most {FIT_PX:g} allowed"
        )
