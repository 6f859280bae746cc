"""From a database to COLMAP's model: pycolmap's incremental mapper, which gives the same model each time."""

import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.collection.workers import WorkerError, WorkerLostError, open_pool, run_tasks
from epiprior.io.colmap import quiet
from epiprior.types import FloatArray

logger = logging.getLogger(__name__)
_TRIES = 3
_LEAST_IMAGES = 4  # whose intrinsics one bundle adjustment refines, where they are nearly known
_FOCAL_RATIOS = (0.3, 5.0)  # of a focal length to the longer side of its image, which few lenses leave
_SHARE_BEYOND = 0.2  # of the unknown cameras: from it on a model has drifted


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
    drifted: bool = False  # whether its focal lengths are not to be believed


def map_beside(database: Path, image_root: Path, out: Path, seed: int, *, refine: bool = True) -> list[Model]:
    """Do what `map_database` does in a process of its own, again with the next seed where the mapper crashes.

    pycolmap 4.2 does so once in a while where photographs share a camera of unknown focal length. WorkerLostError if it
    does three times.
    """

    def run(mapping: Callable[..., list[Model]], *rest: Any) -> list[Model]:
        with open_pool(1) as pool:
            ((_, found),) = run_tasks(pool, mapping, [(0, (database, image_root, out, number, *rest))])
        return list(found)

    for number in range(seed, seed + _TRIES):
        try:
            models = run(map_once, refine)
            break
        except WorkerLostError:
            logger.warning("COLMAP's mapper crashed, or was killed, with seed %s", number)
    else:
        raise WorkerLostError(f"COLMAP's mapper crashed {_TRIES} times; {database} is complete: map it in another way")
    try:
        return run(map_again, models) if models and models[0].drifted else models
    except WorkerError as error:
        logger.warning("the model with focal lengths from pairs failed: %s", error)
        return models


def map_database(database: Path, image_root: Path, out: Path, *, seed: int = 0, refine: bool = True) -> list[Model]:
    """Map a database; return its models, the one with most images first, none where nothing could be mapped.

    `out` is made anew: a folder ``0``, ``1``, ... for each model. One thread and a fixed seed give the same bytes.
    Without `refine` the intrinsics of the cameras stay as they are. With it, cameras with a prior focal length stay
    while the model grows; if all have one, they are refined last. Few photographs do not determine a focal length: if
    those of the largest model end beyond what lenses have, see `map_again`.
    """
    models = map_once(database, image_root, out, seed, refine)
    return map_again(database, image_root, out, seed, models) if models and models[0].drifted else models


def map_once(database: Path, image_root: Path, out: Path, seed: int, refine: bool) -> list[Model]:
    """Do what `map_database` does, once."""
    unknown = {number for number, camera in _cameras(database).items() if not camera.has_prior_focal_length}
    return _map(database, image_root, out, seed, refine=refine, unknown=unknown if refine else set())


def map_again(database: Path, image_root: Path, out: Path, seed: int, models: list[Model]) -> list[Model]:
    """Map with the median focal length of view graph calibration, refined last, for cameras without a prior one.

    Returns `models`, and leaves them in `out`, unless the new model has not drifted and as many images.
    """
    with tempfile.TemporaryDirectory(dir=out.parent) as scratch:
        copy, again = Path(scratch, "database.db"), Path(scratch, "sparse")
        unknown = copy_with_median(database, copy, seed)
        better = _map(copy, image_root, again, seed, refine=True, unknown=unknown) if unknown else []
        if not better or better[0].drifted or len(better[0].seen) < len(models[0].seen):
            return models
        shutil.rmtree(out)
        again.rename(out)
    return [replace(model, folder=out / model.folder.name) for model in better]


def _map(database: Path, image_root: Path, out: Path, seed: int, *, refine: bool, unknown: set[int]) -> list[Model]:
    """Map once; `unknown` are the cameras that may drift."""
    import pycolmap

    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    known = {number for number, camera in _cameras(database).items() if camera.has_prior_focal_length}
    last = refine and len(known) == len(_cameras(database))
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.ignore_watermarks = 1, seed % 2**31, True
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine and not last
    options.constant_cameras = known
    models = []
    with quiet():
        for number, reconstruction in sorted(pycolmap.incremental_mapping(database, image_root, out, options).items()):
            folder = out / str(number)
            if last and reconstruction.num_reg_images() >= _LEAST_IMAGES:
                _adjust(reconstruction)
                reconstruction.write(folder)
            reconstruction.export_PLY(folder / "points.ply")
            models.append(_model(folder, reconstruction, unknown))
    return sorted(models, key=lambda model: -len(model.seen))


def _adjust(reconstruction: Any) -> None:
    """Refine a model with its intrinsics: ``pycolmap.bundle_adjustment`` on one thread, without a line on stderr."""
    import pycolmap

    options, config = pycolmap.BundleAdjustmentOptions(), pycolmap.BundleAdjustmentConfig()
    options.print_summary, options.ceres.solver_options.num_threads = False, 1
    for image in reconstruction.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    reconstruction.update_point_3d_errors()


def copy_with_median(database: Path, copy: Path, seed: int) -> set[int]:
    """Copy a database, with the median of calibrated focal lengths as prior; return the cameras that had none.

    None are returned, and the copy is of no use, where calibration tells nothing. A length is in units of the longer
    side. By COLMAP's view graph calibration (Fetzer et al., WACV 2020; Sweeney et al., ICCV 2015), which for a single
    camera may be far off.
    """
    import pycolmap

    options = pycolmap.ViewGraphCalibrationOptions()
    options.random_seed, options.reestimate_relative_pose = seed % 2**31, False
    shutil.copyfile(database, copy)
    with quiet():
        pycolmap.calibrate_view_graph(copy, options)  # changes geometries as well
    calibrated = _cameras(copy)
    shutil.copyfile(database, copy)
    cameras = _cameras(copy)
    both = [(_focal_ratio(calibrated[number]), _focal_ratio(camera)) for number, camera in cameras.items()]
    ratios = [after for after, before in both if after != before]
    ratio = round(float(np.median(ratios)), 3) if ratios else 0.0  # its solver has many threads
    if not _FOCAL_RATIOS[0] < ratio < _FOCAL_RATIOS[1]:
        return set()
    unknown = {number: camera for number, camera in cameras.items() if not camera.has_prior_focal_length}
    with pycolmap.Database.open(copy) as opened:
        for camera in unknown.values():
            for place in camera.focal_length_idxs():
                camera.params[place] = ratio * max(camera.width, camera.height)
            camera.has_prior_focal_length = True
            opened.update_camera(camera)
    return set(unknown)


def _cameras(database: Path) -> dict[int, Any]:
    import pycolmap

    with pycolmap.Database.open(database) as opened:
        return {camera.camera_id: camera for camera in opened.read_all_cameras()}


def _focal_ratio(camera: Any) -> float:
    return float(camera.mean_focal_length() / max(camera.width, camera.height))


def _has_drifted(reconstruction: Any, unknown: set[int]) -> bool:
    """Return whether many of the unknown cameras of registered images have a focal length beyond the limits."""
    used = {reconstruction.images[image].camera_id for image in reconstruction.reg_image_ids()} & unknown
    ratios = [_focal_ratio(reconstruction.cameras[number]) for number in used]
    beyond = sum(not _FOCAL_RATIOS[0] < ratio < _FOCAL_RATIOS[1] for ratio in ratios)
    return beyond > 0 and beyond >= _SHARE_BEYOND * len(ratios)


def _model(folder: Path, reconstruction: Any, unknown: set[int]) -> Model:
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
        drifted=_has_drifted(reconstruction, unknown),
    )
