"""Features, matches, triangulation and mapping by pycolmap, with fixed seeds.

Extraction and verification of a pair do not depend on the number of threads; mapping and triangulation run with one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.pairsets import Camera, DatasetError
from epiprior_lab.pairsets.importers.progress import progress_bar
from epiprior_lab.pairsets.importers.structure import HALF_PIXEL

SEED = 0


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence pycolmap's log below errors; it writes to stderr."""
    import pycolmap

    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def match_images(database: Path, images: Path, names: Sequence[str], *, max_side: int) -> None:
    """Find SIFT features in photographs and match all pairs of them into a new database, a camera per photograph.

    Parameters
    ----------
    database : Path
        Must not exist.
    images : Path
        Folder that `names` are relative to.
    names : sequence of str
        Files.
    max_side : int
        Features are sought in smaller copies of larger photographs, pixels.

    Raises
    ------
    DatasetError
        If pycolmap cannot read a photograph, or finds nothing in it.
    """
    import pycolmap

    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size, extraction.use_gpu = max_side, False
    mode = pycolmap.CameraMode.PER_IMAGE
    with progress_bar("features", len(names)) as advance:
        for name in names:
            try:
                pycolmap.extract_features(
                    database, images, image_names=[name], camera_mode=mode, extraction_options=extraction
                )
            except (ValueError, RuntimeError) as error:
                raise DatasetError(f"{images / name}: pycolmap cannot read it: {error}") from error
            advance()
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.use_gpu = False
    verification.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    listing = database.with_suffix(".pairs.txt")
    with progress_bar("matching", len(names)) as advance:
        for index, name in enumerate(names):
            listing.write_text("".join(f"{name} {other}\n" for other in names[:index]), encoding="utf-8")
            pairing.match_list_path = listing
            if index:
                pycolmap.match_image_pairs(database, matching, pairing, verification)
            advance()


def map_images(database: Path, images: Path, out: Path, count: int) -> list[Any]:
    """Return the models of pycolmap's incremental mapping, the largest first; each has three photographs or more."""
    import pycolmap

    out.mkdir(parents=True, exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = 1, SEED, 3
    options.extract_colors = False
    with progress_bar("structure from motion", count) as advance:
        models = pycolmap.incremental_mapping(
            database, images, out, options, initial_image_pair_callback=advance, next_image_callback=advance
        )
    return sorted(models.values(), key=lambda model: -int(model.num_reg_images()))


def triangulate(database: Path, images: Path, out: Path, cameras: dict[str, Camera]) -> Any:
    """Return a reconstruction with given cameras and points triangulated from the matches of a database.

    Parameters
    ----------
    database : Path
        From `match_images`.
    images, out : Path
        Folder of photographs; folder for pycolmap's files.
    cameras : dict of str to Camera
        By the photographs' names in the database.
    """
    import pycolmap

    reconstruction = pycolmap.Reconstruction()
    known = pycolmap.Database.open(database)
    try:
        images_there = known.read_all_images()
        for image in images_there:
            camera = cameras[image.name]
            K = camera.K
            parameters = [K[0, 0], K[1, 1], K[0, 2] + HALF_PIXEL, K[1, 2] + HALF_PIXEL]
            pinhole = pycolmap.Camera(
                model="PINHOLE",
                width=camera.width,
                height=camera.height,
                params=parameters,
                camera_id=image.camera_id,
                has_prior_focal_length=True,
            )
            known.update_camera(pinhole)
            reconstruction.add_camera_with_trivial_rig(pinhole)
            pose = pycolmap.Rigid3d(np.column_stack([camera.R, camera.t]))
            placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            reconstruction.add_image_with_trivial_frame(placed, pose)
    finally:
        known.close()
    out.mkdir(parents=True, exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, SEED
    return pycolmap.triangulate_points(reconstruction, database, images, out, options=options)
