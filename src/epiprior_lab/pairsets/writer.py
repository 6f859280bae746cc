"""Writer of pair sets with cameras and depth maps, from encoded files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from epiprior_lab.pairsets.cameras import Camera, Cameras
from epiprior_lab.pairsets.files import DatasetError, write_tables


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFiles:
    """A pair with cameras, its files encoded, depth by `encode_depth`; `pair_id` becomes the stem of the files."""

    pair_id: str
    scene: str
    difficulty: str
    cameras: Cameras
    jpegs: tuple[bytes, bytes]
    depths: tuple[bytes, bytes]


def write_pair_set(root: Path, pairs: Sequence[PairFiles]) -> None:
    """Write a pair set into the folder `root`, made if absent; equal input gives equal bytes.

    DatasetError if there is no pair or a pair id is there twice.
    """
    names = {pair.pair_id for pair in pairs}
    if not names or len(names) < len(pairs):
        raise DatasetError(f"{root}: {len(pairs)} pairs with {len(names)} pair ids; expected some, all different")
    rows: list[list[str]] = []
    cameras: dict[str, Camera] = {}
    for folder in ("images", "depth"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    for pair in pairs:
        images = [f"images/{pair.pair_id}_{side}.jpg" for side in (1, 2)]
        for image, jpeg, depth in zip(images, pair.jpegs, pair.depths, strict=True):
            (root / image).write_bytes(jpeg)
            (root / "depth" / f"{Path(image).stem}.npz").write_bytes(depth)
        rows.append([pair.pair_id, *images, "cameras", pair.scene, pair.difficulty])
        cameras |= zip(images, pair.cameras, strict=True)
    write_tables(root, rows, cameras)
