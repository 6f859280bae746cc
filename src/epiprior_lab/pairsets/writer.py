"""Writer of pair sets with cameras and depth maps, from encoded files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from epiprior_lab.pairsets.cameras import Camera
from epiprior_lab.pairsets.files import CAMERA_COLUMNS, PAIR_COLUMNS, DatasetError, camera_row, write_table


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFiles:
    """A pair with cameras, its files encoded, depth by `encode_depth`; `pair_id` becomes the stem of the files."""

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
    """Write a pair set into the folder `root`, made if absent; equal input gives equal bytes.

    DatasetError if there is no pair or a pair id is there twice.
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
