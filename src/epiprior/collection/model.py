"""From a database to COLMAP's model: pycolmap's incremental mapper, which gives the same model each time."""

import logging
import shutil
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.collection.workers import WorkerLostError, open_pool, run_tasks
from epiprior.io.colmap import quiet
from epiprior.types import FloatArray

logger = logging.getLogger(__name__)
_TRIES = 3


@dataclass(frozen=True, kw_only=True)
class Model:
    """A model that the mapper has written to `folder`, with `points.ply` beside its binary files."""

    folder: Path
    seen: Mapping[str, int]  # number of points that each registered image sees, by name
    centres: FloatArray  # (N, 3), of the cameras of the registered images, in the order of `seen`
    rotations: FloatArray  # (N, 3, 3), from the world to these cameras
    points: FloatArray  # (P, 3)
    colours: NDArray[np.uint8]  # (P, 3), RGB
    tracks: Mapping[int, int]  # how many points are seen by how many images
    error_px: float  # mean reprojection error


def map_beside(database: Path, image_root: Path, out: Path, seed: int) -> list[Model]:
    """Do what `map_database` does in a process of its own, again with the next seed where the mapper crashes.

    pycolmap 4.2 does so once in a while where photographs share a camera of unknown focal length. WorkerLostError if it
    does three times.
    """
    for number in range(seed, seed + _TRIES):
        try:
            with open_pool(1) as pool:
                mapping = partial(map_database, seed=number)
                (models,) = (found for _, found in run_tasks(pool, mapping, [(0, (database, image_root, out))]))
            return list(models)
        except WorkerLostError:
            logger.warning("COLMAP's mapper crashed, or was killed, with seed %s", number)
    raise WorkerLostError(f"COLMAP's mapper crashed {_TRIES} times; {database} is complete: map it in another way")


def map_database(database: Path, image_root: Path, out: Path, *, seed: int = 0, refine: bool = True) -> list[Model]:
    """Map a database; return its models, the one with most images first, none where nothing could be mapped.

    `out` is made anew: a folder ``0``, ``1``, ... for each model. One thread and a fixed seed give the same bytes.
    Without `refine` the intrinsics of the cameras stay as they are.
    """
    import pycolmap

    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.ignore_watermarks = 1, seed % 2**31, True
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine
    with quiet():
        found = pycolmap.incremental_mapping(database, image_root, out, options)
    models = []
    for number, reconstruction in sorted(found.items()):
        reconstruction.export_PLY(out / str(number) / "points.ply")
        models.append(_model(out / str(number), reconstruction))
    return sorted(models, key=lambda model: -len(model.seen))


def _model(folder: Path, reconstruction: Any) -> Model:
    images = sorted((image for image in reconstruction.images.values() if image.has_pose), key=lambda i: str(i.name))
    poses = np.array([image.cam_from_world().matrix() for image in images]).reshape(-1, 3, 4)
    points = list(reconstruction.points3D.values())
    return Model(
        folder=folder,
        seen={str(image.name): int(image.num_points3D) for image in images},
        centres=-np.einsum("nji,nj->ni", poses[:, :, :3], poses[:, :, 3]),
        rotations=poses[:, :, :3],
        points=np.array([point.xyz for point in points]).reshape(-1, 3),
        colours=np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        tracks=Counter(len({e.image_id for e in point.track.elements}) for point in points),
        error_px=float(reconstruction.compute_mean_reprojection_error()),
    )
