"""Writer of pair sets in the uniform format."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.files import CAMERA_COLUMNS, PAIR_COLUMNS, POINT_COLUMNS, DatasetError


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFiles:
    """A pair with cameras, its files encoded.

    Parameters
    ----------
    pair_id, scene : str
        Names; `pair_id` becomes the stem of the files.
    difficulty : str
        For a reader.
    camera1, camera2 : Camera
        Cameras of both images.
    jpeg1, jpeg2 : bytes
        The images.
    depth1, depth2 : bytes
        The depth maps, as `encode_depth` makes them.
    """

    pair_id: str
    scene: str
    difficulty: str
    camera1: Camera
    camera2: Camera
    jpeg1: bytes
    jpeg2: bytes
    depth1: bytes
    depth2: bytes


def write_pair_set(root: Path, pairs: Sequence[PairFiles]) -> None:
    """Write a pair set with cameras and depth maps; equal input gives equal bytes.

    Parameters
    ----------
    root : Path
        Folder of the set, made if absent.
    pairs : sequence of PairFiles
        At least one; pair ids are unique.

    Raises
    ------
    DatasetError
        If there is no pair or a pair id is there twice.
    """
    names = [pair.pair_id for pair in pairs]
    if not names or len(set(names)) < len(names):
        raise DatasetError(
            f"{root}: {len(names)} pairs with {len(set(names))} pair ids; expected one or more, all different"
        )
    pair_rows, camera_rows = [], []
    (root / "images").mkdir(parents=True, exist_ok=True)
    (root / "depth").mkdir(exist_ok=True)
    for pair in pairs:
        stems = f"{pair.pair_id}_1", f"{pair.pair_id}_2"
        images = [f"images/{stem}.jpg" for stem in stems]
        for stem, jpeg, depth in zip(stems, (pair.jpeg1, pair.jpeg2), (pair.depth1, pair.depth2), strict=True):
            (root / "images" / f"{stem}.jpg").write_bytes(jpeg)
            (root / "depth" / f"{stem}.npz").write_bytes(depth)
        pair_rows.append([pair.pair_id, *images, "cameras", pair.scene, pair.difficulty])
        camera_rows += [camera_row(images[0], pair.camera1), camera_row(images[1], pair.camera2)]
    write_table(root / "pairs.csv", PAIR_COLUMNS, pair_rows)
    write_table(root / "cameras.csv", CAMERA_COLUMNS, camera_rows)


def write_control_points(path: Path, x1: FloatArray, x2: FloatArray) -> None:
    """Write matched points, two arrays of shape (N, 2), with a millionth of a pixel."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [[f"{value:.6f}" for value in row] for row in np.column_stack([x1, x2])]
    write_table(path, POINT_COLUMNS, rows)


def write_matrix(path: Path, matrix: FloatArray) -> None:
    """Write a 3 x 3 matrix as three lines of text, floats as their shortest exact text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(" ".join(repr(float(value)) for value in row) + "\n" for row in matrix), encoding="utf-8")


def camera_row(image: str, camera: Camera) -> list[str]:
    """Return a row of ``cameras.csv``; floats as their shortest exact text.

    Raises
    ------
    DatasetError
        If the camera has a skew, for which there is no column.
    """
    K = camera.K
    if abs(K[0, 1]) > 1e-6 * K[0, 0]:
        raise DatasetError(f"camera of {image!r}: a skew of {K[0, 1]:g} px cannot be written")
    numbers = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.R.ravel(), *camera.t]
    return [image, str(camera.width), str(camera.height), *(repr(float(number)) for number in numbers)]


def write_table(path: Path, columns: tuple[str, ...], rows: list[list[str]]) -> None:
    """Write a comma-separated table with Unix line ends."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
