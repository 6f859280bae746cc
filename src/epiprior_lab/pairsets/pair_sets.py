"""Reader of a pair set: a folder with ``pairs.csv``, images, and what is true of each pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.checks import check_pair
from epiprior_lab.pairsets.files import PAIR_COLUMNS, DatasetError, read_cameras, read_table
from epiprior_lab.pairsets.images import check_pixels, image_size
from epiprior_lab.pairsets.pair import Pair

GROUND_TRUTHS = ("cameras", "control_points", "homography", "fundamental")


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
    """Read a pair set and check it, in milliseconds per pair.

    Depth maps and the pixels of images are left for later (`check_pair_set` reads them); the sizes of images come from
    their headers.

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
        twice, a value is wrong, an image has another size than its camera, or control points do not fit (see
        `check_pair`). The message names the file and line.
    """
    root = Path(root)
    points_folder = root / "control_points" if control_points is None else Path(control_points)
    if control_points is not None and not points_folder.is_dir():
        raise DatasetError(f"{points_folder}: no such folder of control points")
    table = root / "pairs.csv"
    reader = _Reader(root=root, points_folder=points_folder, sizes={})
    cameras: dict[str, Camera] | None = None
    pairs: list[Pair] = []
    seen: set[str] = set()
    for line, row in read_table(table, PAIR_COLUMNS):
        where = f"{table}, line {line}"
        if row["pair_id"] in seen or not row["pair_id"]:
            raise DatasetError(f"{where}: pair_id {row['pair_id']!r} is empty or there twice")
        if Path(row["pair_id"]).name != row["pair_id"]:
            raise DatasetError(f"{where}: pair_id {row['pair_id']!r} is no file name")
        if row["gt"] not in GROUND_TRUTHS:
            raise DatasetError(f"{where}: gt = {row['gt']!r}, expected one of {', '.join(GROUND_TRUTHS)}")
        if cameras is None and row["gt"] == "cameras":
            cameras = read_cameras(root / "cameras.csv")
        seen.add(row["pair_id"])
        pairs.append(reader.pair(row, cameras or {}, where))
    if not pairs:
        raise DatasetError(f"{table}: no pair")
    return PairSet(name=root.resolve().name, pairs=tuple(pairs))


def check_pair_set(root: Path | str, *, on_pair: Callable[[], None] = lambda: None) -> PairSet:
    """Read a pair set, and then its depth maps and images too.

    Parameters
    ----------
    root : Path or str
        Folder with ``pairs.csv``.
    on_pair : callable, optional
        Called after each pair, for a progress bar.

    Returns
    -------
    PairSet
        As from `read_pair_set`.

    Raises
    ------
    DatasetError
        As from `read_pair_set`, or if a depth map or an image cannot be decoded.
    """
    pair_set = read_pair_set(root)
    decoded: set[Path] = set()
    for pair in pair_set.pairs:
        pair.depths()
        for path in sorted({pair.image1, pair.image2} - decoded):
            check_pixels(path)
            decoded.add(path)
        on_pair()
    return pair_set


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reader:
    """Makes pairs of rows; looks at each image once."""

    root: Path
    points_folder: Path
    sizes: dict[str, tuple[int, int]]

    def pair(self, row: dict[str, str], cameras: dict[str, Camera], where: str) -> Pair:
        names = row["image1"], row["image2"]
        with_cameras = row["gt"] == "cameras"
        for name in names:
            self._check_image(name, cameras.get(name) if with_cameras else None, with_cameras, where)
        points = self.points_folder / f"{row['pair_id']}.csv"
        if row["gt"] == "control_points" and not points.is_file():
            raise DatasetError(f"{where}: no control points {points}")
        depths = [self.root / "depth" / f"{Path(name).stem}.npz" for name in names]
        pair = Pair(
            pair_id=row["pair_id"],
            scene=row["scene"],
            image1=self.root / names[0],
            image2=self.root / names[1],
            camera1=cameras[names[0]] if with_cameras else None,
            camera2=cameras[names[1]] if with_cameras else None,
            difficulty=row["difficulty"],
            control_points_path=points if points.is_file() else None,
            depth_paths=(depths[0], depths[1]) if all(path.is_file() for path in depths) else None,
            homography_path=self._matrix(row, "homography", where),
            fundamental_path=self._matrix(row, "fundamental", where),
        )
        # Damage is found here, not after hours of work.
        pair.homography()
        pair.fundamental()
        check_pair(pair, (self.sizes[names[0]], self.sizes[names[1]]), where)
        return pair

    def _check_image(self, name: str, camera: Camera | None, with_cameras: bool, where: str) -> None:
        path = self.root / name
        if not path.is_file():
            raise DatasetError(f"{where}: no image {path}")
        if with_cameras and camera is None:
            raise DatasetError(f"{where}: {self.root / 'cameras.csv'} has no camera of {name!r}")
        if name not in self.sizes:
            self.sizes[name] = image_size(path)
        width, height = self.sizes[name]
        if camera is not None and (camera.width, camera.height) != (width, height):
            raise DatasetError(
                f"{where}: {path} is {width} x {height}, its camera in {self.root / 'cameras.csv'} "
                f"{camera.width} x {camera.height}"
            )

    def _matrix(self, row: dict[str, str], kind: str, where: str) -> Path | None:
        if row["gt"] != kind:
            return None
        path = self.root / kind / f"{row['pair_id']}.txt"
        if not path.is_file():
            raise DatasetError(f"{where}: no {kind} {path}")
        return path
