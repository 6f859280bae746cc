"""Pair sets made of others: second photographs turned by a quarter or a half, or shrunk, and their truth with them."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from epiprior.features.images import read_image
from epiprior.types import FloatArray
from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.files import (
    CAMERA_COLUMNS,
    PAIR_COLUMNS,
    DatasetError,
    camera_row,
    write_control_points,
    write_matrix,
    write_table,
)
from epiprior_lab.pairsets.pair import Pair

EVERY = 16  # of all pairs, in their order, one in so many is changed

Size = tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """A change of an image: its new size, the 3 x 3 map of its pixels, and how directions in the camera turn."""

    size: Size
    pixels: FloatArray
    turn: FloatArray


def _turned(quarters: int) -> Callable[[Size], Change]:
    """Return a turn clockwise, as seen on the screen."""

    def change(size: Size) -> Change:
        pixels, turn, (width, height) = np.eye(3), np.eye(3), size
        for _ in range(quarters):
            pixels = np.array([[0.0, -1.0, height - 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ pixels
            turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ turn
            width, height = height, width
        return Change(size=(width, height), pixels=pixels, turn=turn)

    return change


def _shrunk(factor: int) -> Callable[[Size], Change]:
    def change(size: Size) -> Change:
        small = tuple(max(1, round(side / factor)) for side in size)
        x, y = (new / old for new, old in zip(small, size, strict=True))
        pixels = np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])
        return Change(size=(small[0], small[1]), pixels=pixels, turn=np.eye(3))

    return change


CHANGES: Mapping[str, Callable[[Size], Change]] = {
    "turned90": _turned(1),
    "turned180": _turned(2),
    "shrunk4": _shrunk(4),
}
_ROTATIONS = {"turned90": cv2.ROTATE_90_CLOCKWISE, "turned180": cv2.ROTATE_180}


def chosen_pairs(sets: Mapping[str, Sequence[Pair]], *, without: Sequence[str] = ()) -> dict[str, Pair]:
    """Return one in `EVERY` of the pairs of all sets, by the name that it has when changed, ``<set>-<pair id>``.

    Pairs whose ids are in `without` are passed over.
    """
    every = [(f"{name}-{pair.pair_id}", pair) for name, pairs in sets.items() for pair in pairs]
    return dict([(name, pair) for name, pair in every if pair.pair_id not in without][::EVERY])


def write_changed_set(root: Path, pairs: Mapping[str, Pair], change: str) -> None:
    """Write a pair set, `root`, anew: the second photographs of `pairs`, by their new ids, changed by one of `CHANGES`.

    First photographs are copied; second ones are written as PNG, so that nothing is lost but what shrinking loses.
    DatasetError for a pair with depth maps, ImageError for an image that cannot be read.
    """
    if root.is_dir():
        shutil.rmtree(root)  # what is left of another choice of pairs would count as part of the set
    (root / "images").mkdir(parents=True)
    pair_rows, camera_rows = [], []
    for name, pair in pairs.items():
        if pair.depth_paths is not None:
            raise DatasetError(f"{root}: depth maps, which pair {pair.pair_id!r} has, are not changed")
        how = CHANGES[change](pair.sizes()[1])
        images = [f"images/{name}-1{pair.image1.suffix}", f"images/{name}-2.png"]
        shutil.copyfile(pair.image1, root / images[0])
        image = read_image(pair.image2, cv2.IMREAD_COLOR)
        turned = change in _ROTATIONS
        new = (
            cv2.rotate(image, _ROTATIONS[change])
            if turned
            else cv2.resize(image, how.size, interpolation=cv2.INTER_AREA)
        )
        cv2.imwrite(str(root / images[1]), new)
        if pair.control_points_path is not None:
            x1, x2 = pair.control_points()
            x2 = np.column_stack([x2, np.ones(len(x2))]) @ how.pixels[:2].T
            write_control_points(root / "control_points" / f"{name}.csv", x1, x2)
        truth = _write_matrix(root, name, pair, how)
        if pair.camera1 is not None and pair.camera2 is not None:
            truth = "cameras"
            camera_rows += [camera_row(images[0], pair.camera1), camera_row(images[1], _changed(pair.camera2, how))]
        pair_rows.append([name, *images, truth, f"{name.removesuffix(pair.pair_id)}{pair.scene}", pair.difficulty])
    write_table(root / "pairs.csv", PAIR_COLUMNS, pair_rows)
    if camera_rows:
        write_table(root / "cameras.csv", CAMERA_COLUMNS, camera_rows)


def _write_matrix(root: Path, name: str, pair: Pair, how: Change) -> str:
    """Write what maps pixels, or pixels to lines, where there is such a matrix; return the kind of truth."""
    H, F = pair.homography(), pair.fundamental()
    if H is not None:
        write_matrix(root / "homography" / f"{name}.txt", how.pixels @ H)
        return "homography"
    if pair.fundamental_path is not None and F is not None:
        write_matrix(root / "fundamental" / f"{name}.txt", np.linalg.inv(how.pixels).T @ F)
        return "fundamental"
    return "control_points"


def _changed(camera: Camera, how: Change) -> Camera:
    """Return the camera of the changed image: its axes turn with the image, so that they point right and down again."""
    K = how.pixels @ camera.K @ how.turn.T
    return replace(camera, K=K, R=how.turn @ camera.R, t=how.turn @ camera.t, width=how.size[0], height=how.size[1])
