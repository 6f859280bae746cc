"""From a database to COLMAP's model: pycolmap's incremental mapper, which gives the same model each time."""

import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from epiprior.collection.workers import WorkerLostError, open_pool, run_tasks
from epiprior.io.colmap import quiet
from epiprior.types import FloatArray

logger = logging.getLogger(__name__)
_TRIES = 3
_DETERMINED = 4  # images, of which one bundle adjustment determines intrinsics that are nearly known
_FOCAL_RATIOS = (0.3, 5.0)  # of a focal length to the longer side of its image: beyond, it has drifted
Refine = Literal["always", "last", "never"]


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


def map_beside(database: Path, image_root: Path, out: Path, seed: int, refine: Refine = "always") -> list[Model]:
    """Do what `map_database` does in a process of its own, again with the next seed where the mapper crashes.

    pycolmap 4.2 does so once in a while where photographs share a camera of unknown focal length. WorkerLostError if it
    does three times.
    """
    for number in range(seed, seed + _TRIES):
        try:
            with open_pool(1) as pool:
                mapping = partial(map_database, seed=number, refine=refine)
                (models,) = (found for _, found in run_tasks(pool, mapping, [(0, (database, image_root, out))]))
            return list(models)
        except WorkerLostError:
            logger.warning("COLMAP's mapper crashed, or was killed, with seed %s", number)
    raise WorkerLostError(f"COLMAP's mapper crashed {_TRIES} times; {database} is complete: map it in another way")


def map_database(
    database: Path, image_root: Path, out: Path, *, seed: int = 0, refine: Refine = "always"
) -> list[Model]:
    """Map a database; return its models, the one with most images first, none where nothing could be mapped.

    `out` is made anew: a folder ``0``, ``1``, ... for each model. One thread and a fixed seed give the same bytes.
    Intrinsics are refined while the model grows (``always``), by one bundle adjustment of a model of four or more
    images (``last``), or ``never``. Few photographs determine no focal length: where one has drifted to what no lens
    has, all is mapped again by those that the fundamental matrices tell, which are refined last.
    """
    found = _map(database, image_root, out, seed, refine)
    if refine == "always" and any(map(_has_drifted, found)):
        with tempfile.TemporaryDirectory() as scratch:
            copy, again = Path(scratch, "database.db"), Path(scratch, "sparse")
            better = _map(copy, image_root, again, seed, "last") if _with_focal_lengths(database, copy, seed) else []
            if better and not any(map(_has_drifted, better)):
                found = better
                shutil.rmtree(out)
                shutil.copytree(again, out)
    models = [_model(out / str(number), reconstruction) for number, reconstruction in enumerate(found)]
    return sorted(models, key=lambda model: -len(model.seen))


def _map(database: Path, image_root: Path, out: Path, seed: int, refine: Refine) -> list[Any]:
    """Write reconstructions to the folders ``0``, ``1``, ... of `out`, and return them."""
    import pycolmap

    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    options, adjustment = pycolmap.IncrementalPipelineOptions(), pycolmap.BundleAdjustmentOptions()
    options.num_threads, options.random_seed, options.ignore_watermarks = 1, seed % 2**31, True
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine == "always"
    adjustment.print_summary, adjustment.ceres.solver_options.num_threads = False, 1
    with quiet():
        found = [one for _, one in sorted(pycolmap.incremental_mapping(database, image_root, out, options).items())]
        for number, reconstruction in enumerate(found):
            folder = out / str(number)
            if refine == "last" and reconstruction.num_reg_images() >= _DETERMINED:
                config = pycolmap.BundleAdjustmentConfig()
                for image in reconstruction.reg_image_ids():
                    config.add_image(image)
                config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
                pycolmap.create_default_bundle_adjuster(adjustment, config, reconstruction).solve()
                if _has_drifted(reconstruction):
                    found[number] = pycolmap.Reconstruction(folder)
                else:
                    reconstruction.write(folder)
            found[number].export_PLY(folder / "points.ply")
    return found


def _has_drifted(reconstruction: Any) -> bool:
    ratios = map(_focal_ratio, reconstruction.cameras.values())
    return not all(_FOCAL_RATIOS[0] < ratio < _FOCAL_RATIOS[1] for ratio in ratios)


def _with_focal_lengths(database: Path, copy: Path, seed: int) -> bool:
    """Copy a database, with the median focal length that its pairs tell; False, and of no use, if these tell none.

    By view graph calibration (Sweeney, Sattler, Hollerer, Turk and Pollefeys, ICCV 2015), as pycolmap has it; of single
    cameras it may be far off. Lengths are in units of the longer side; those that were known before stay.
    """
    import pycolmap

    options = pycolmap.ViewGraphCalibrationOptions()
    options.random_seed = seed % 2**31
    shutil.copyfile(database, copy)
    with quiet():
        pycolmap.calibrate_view_graph(copy, options)  # geometries too
    told = _cameras(copy)
    shutil.copyfile(database, copy)
    before = _cameras(copy)
    ratios = [
        _focal_ratio(told[number]) for number in before if _focal_ratio(told[number]) != _focal_ratio(before[number])
    ]
    if not ratios:
        return False
    ratio = float(np.clip(np.round(np.median(ratios), 3), *_FOCAL_RATIOS))
    with pycolmap.Database.open(copy) as opened:
        for camera in before.values():
            if not camera.has_prior_focal_length:
                for place in camera.focal_length_idxs():
                    camera.params[place] = ratio * max(camera.width, camera.height)
                opened.update_camera(camera)
    return True


def _cameras(database: Path) -> dict[int, Any]:
    import pycolmap

    with pycolmap.Database.open(database) as opened:
        return {camera.camera_id: camera for camera in opened.read_all_cameras()}


def _focal_ratio(camera: Any) -> float:
    return float(camera.mean_focal_length() / max(camera.width, camera.height))


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
