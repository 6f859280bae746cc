"""Reader of a pair set: a folder with ``pairs.csv``, images, and cameras, control points or depth maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from epiprior.types import Float32Array, FloatArray
from epiprior_lab.datasets.cameras import Camera, fundamental_from_cameras
from epiprior_lab.datasets.files import (
    PAIR_COLUMNS,
    DatasetError,
    read_cameras,
    read_control_points,
    read_depth,
    read_table,
)

GROUND_TRUTHS = ("cameras", "control_points")


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two images of one scene and their ground truth.

    Parameters
    ----------
    pair_id : str
        Unique within the set.
    scene : str
        What splits must not cross.
    image1, image2 : Path
        Image files; they exist.
    camera1, camera2 : Camera or None
        None where the ground truth is control points.
    difficulty : str
        For a reader, for example ``angle=21.5deg;overlap=0.79``.
    control_points_path : Path or None
        Table of control points; None where the set has none.
    depth_paths : tuple of Path or None
        Depth maps of both images; None where the set has none.
    """

    pair_id: str
    scene: str
    image1: Path
    image2: Path
    camera1: Camera | None
    camera2: Camera | None
    difficulty: str
    control_points_path: Path | None = None
    depth_paths: tuple[Path, Path] | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the pair that exist: images, control points, depth maps."""
        points = () if self.control_points_path is None else (self.control_points_path,)
        return (self.image1, self.image2, *points, *(self.depth_paths or ()))

    def control_points(self) -> tuple[FloatArray, FloatArray]:
        """Return the control points, two arrays of shape (N, 2), pixels.

        Raises
        ------
        DatasetError
            If the pair has none, or the file is damaged.
        """
        if self.control_points_path is None:
            raise DatasetError(f"pair {self.pair_id!r} of {self.image1.parent.parent} has no control points")
        return read_control_points(self.control_points_path)

    def fundamental(self) -> FloatArray | None:
        """Return F with ``x2' F x1 = 0`` from the cameras; None without them or with one centre."""
        if self.camera1 is None or self.camera2 is None:
            return None
        return fundamental_from_cameras(self.camera1, self.camera2)

    def depths(self) -> tuple[Float32Array, Float32Array] | None:
        """Return both depth maps, (height, width), inf where nothing is; None where the set has none.

        Raises
        ------
        DatasetError
            If a file is damaged or its size is not the camera's.
        """
        if self.depth_paths is None:
            return None
        depths = []
        for path, camera in zip(self.depth_paths, (self.camera1, self.camera2), strict=True):
            depth = read_depth(path)
            if camera is not None and depth.shape != (camera.height, camera.width):
                raise DatasetError(f"{path}: depth has shape {depth.shape}, camera {camera.height, camera.width}")
            depths.append(depth)
        return depths[0], depths[1]

    def depth_views(self) -> tuple[tuple[Camera, Camera], tuple[Float32Array, Float32Array]]:
        """Return both cameras and both depth maps.

        Raises
        ------
        DatasetError
            If the pair has no depth maps or no cameras, or a file is damaged.
        """
        depths = self.depths()
        if depths is None or self.camera1 is None or self.camera2 is None:
            raise DatasetError(f"pair {self.pair_id!r} of {self.image1.parent.parent} has no depth maps with cameras")
        return (self.camera1, self.camera2), depths


@dataclass(frozen=True, kw_only=True)
class PairSet:
    """The pairs of a folder.

    Parameters
    ----------
    name : str
        Name of the folder.
    pairs : tuple of Pair
        In the order of ``pairs.csv``.
    """

    name: str
    pairs: tuple[Pair, ...]


def read_pair_set(root: Path | str, control_points: Path | str | None = None) -> PairSet:
    """Read and check a pair set; images, depth maps and control points themselves are read later, pair by pair.

    Parameters
    ----------
    root : Path or str
        Folder with ``pairs.csv``.
    control_points : Path or str, optional
        Folder of ``<pair_id>.csv``. The default is ``root/control_points``.

    Returns
    -------
    PairSet
        All pairs.

    Raises
    ------
    DatasetError
        If the folder is no pair set, an image, camera or required file is missing, a pair id is there
        twice, or a value is wrong. The message names the file and line.
    """
    root = Path(root)
    points_folder = root / "control_points" if control_points is None else Path(control_points)
    if control_points is not None and not points_folder.is_dir():
        raise DatasetError(f"{points_folder}: no such folder of control points")
    table = root / "pairs.csv"
    cameras: dict[str, Camera] | None = None
    pairs: list[Pair] = []
    seen: set[str] = set()
    for line, row in read_table(table, PAIR_COLUMNS):
        where = f"{table}, line {line}"
        if row["pair_id"] in seen or not row["pair_id"]:
            raise DatasetError(f"{where}: pair_id {row['pair_id']!r} is empty or there twice")
        if row["gt"] not in GROUND_TRUTHS:
            raise DatasetError(f"{where}: gt = {row['gt']!r}, expected one of {', '.join(GROUND_TRUTHS)}")
        if cameras is None and row["gt"] == "cameras":
            cameras = read_cameras(root / "cameras.csv")
        seen.add(row["pair_id"])
        pairs.append(_pair(root, points_folder, row, cameras or {}, where))
    if not pairs:
        raise DatasetError(f"{table}: no pair")
    return PairSet(name=root.resolve().name, pairs=tuple(pairs))


def _pair(root: Path, points_folder: Path, row: dict[str, str], cameras: dict[str, Camera], where: str) -> Pair:
    """Make a pair of one row of ``pairs.csv`` and check that its files are there."""
    with_cameras = row["gt"] == "cameras"
    for name in (row["image1"], row["image2"]):
        if not (root / name).is_file():
            raise DatasetError(f"{where}: no image {root / name}")
        if with_cameras and name not in cameras:
            raise DatasetError(f"{where}: {root / 'cameras.csv'} has no camera of {name!r}")
    points = points_folder / f"{row['pair_id']}.csv"
    if not with_cameras and not points.is_file():
        raise DatasetError(f"{where}: no control points {points}")
    depths = [root / "depth" / f"{Path(row[name]).stem}.npz" for name in ("image1", "image2")]
    return Pair(
        pair_id=row["pair_id"],
        scene=row["scene"],
        image1=root / row["image1"],
        image2=root / row["image2"],
        camera1=cameras[row["image1"]] if with_cameras else None,
        camera2=cameras[row["image2"]] if with_cameras else None,
        difficulty=row["difficulty"],
        control_points_path=points if points.is_file() else None,
        depth_paths=(depths[0], depths[1]) if all(path.is_file() for path in depths) else None,
    )
