"""Pair sets made of others: second photographs turned by a quarter or a half, or shrunk, and their truth with them."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from epiprior.features.images import read_image
from epiprior.types import FloatArray
from epiprior_lab.pairsets import files
from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.pair import Pair

Size = tuple[int, int]

EVERY = 16  # of all pairs, in their order, one in so many is changed
# Quarter turns of the second photograph, clockwise as seen on the screen, and by what it is shrunk.
CHANGES: Mapping[str, tuple[int, int]] = {"turned90": (1, 1), "turned180": (2, 1), "shrunk4": (0, 4)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """A change of an image: its new size, the 3 x 3 map of its pixels, and how directions in the camera turn."""

    size: Size
    pixels: FloatArray
    turn: FloatArray


def change_of(size: Size, quarters: int, factor: int) -> Change:
    """Return what a change of `CHANGES` makes of an image."""
    pixels, turn, (width, height) = np.eye(3), np.eye(3), size
    for _ in range(quarters):
        pixels = np.array([[0.0, -1.0, height - 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ pixels
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ turn
        width, height = height, width
    small = max(1, round(width / factor)), max(1, round(height / factor))
    return Change(size=small, pixels=shrinking((width, height), small) @ pixels, turn=turn)


def shrinking(old: Size, new: Size) -> FloatArray:
    """Return the 3 x 3 map of pixels when an image of size `old` becomes `new` (width, height): corners to corners."""
    x, y = (after / before for before, after in zip(old, new, strict=True))
    return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


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
    rows: list[list[str]] = []
    cameras: dict[str, Camera] = {}
    for name, pair in pairs.items():
        if pair.depth_paths is not None:
            raise files.DatasetError(f"{root}: depth maps, which pair {pair.pair_id!r} has, are not changed")
        how = change_of(pair.sizes()[1], *CHANGES[change])
        images = [f"images/{name}-1{pair.image1.suffix}", f"images/{name}-2.png"]
        shutil.copyfile(pair.image1, root / images[0])
        image = read_image(pair.image2, cv2.IMREAD_COLOR)
        turned = np.ascontiguousarray(np.rot90(image, -CHANGES[change][0]))
        cv2.imwrite(str(root / images[1]), cv2.resize(turned, how.size, interpolation=cv2.INTER_AREA))
        if pair.control_points_path is not None:
            x1, x2 = pair.control_points()
            x2 = np.column_stack([x2, np.ones(len(x2))]) @ how.pixels[:2].T
            files.write_control_points(root / "control_points" / f"{name}.csv", x1, x2)
        truth = _write_matrix(root, name, pair, how)
        if pair.camera1 is not None and pair.camera2 is not None:
            truth = "cameras"
            cameras |= zip(images, (pair.camera1, _changed(pair.camera2, how)), strict=True)
        rows.append([name, *images, truth, f"{name.removesuffix(pair.pair_id)}{pair.scene}", pair.difficulty])
    files.write_tables(root, rows, cameras)


def _write_matrix(root: Path, name: str, pair: Pair, how: Change) -> str:
    """Write what maps pixels, or pixels to lines, where there is such a matrix; return the kind of truth."""
    H, F = pair.homography(), pair.fundamental()
    if H is not None:
        files.write_matrix(root / "homography" / f"{name}.txt", how.pixels @ H)
        return "homography"
    if pair.fundamental_path is not None and F is not None:
        files.write_matrix(root / "fundamental" / f"{name}.txt", np.linalg.inv(how.pixels).T @ F)
        return "fundamental"
    return "control_points"


def _changed(camera: Camera, how: Change) -> Camera:
    """Return the camera of the changed image: its axes turn with the image, so that they point right and down again."""
    K = how.pixels @ camera.K @ how.turn.T
    return replace(camera, K=K, R=how.turn @ camera.R, t=how.turn @ camera.t, width=how.size[0], height=how.size[1])
