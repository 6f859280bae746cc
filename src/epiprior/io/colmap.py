"""The one way to write into a COLMAP database, from which COLMAP or pycolmap maps without matching anything itself.

COLMAP puts the centre of the top-left pixel at (0.5, 0.5): that half pixel is added here and nowhere else. Its mapper
reads ``two_view_geometries``, yet counts a pair only where ``matches`` holds it too: both are written.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from epiprior.errors import ImageError, OutputError, require
from epiprior.estimators.essential import Intrinsics
from epiprior.features.images import read_image
from epiprior.io.output import check_output
from epiprior.types import FloatArray, FundamentalEstimate, Geometry, IntArray

_CONFIGURATIONS = {Geometry.PLANAR: "PLANAR", Geometry.ROTATION: "PANORAMIC", Geometry.IDENTICAL: "WATERMARK"}
_EXIF = (b"Exif", b"eXIf", b"EXIF")  # what introduces an orientation in JPEG, PNG and WebP
_HALF_PIXEL = 0.5  # COLMAP has the centre of the top-left pixel there
_TO_OURS = np.array([[1.0, 0.0, -_HALF_PIXEL], [0.0, 1.0, -_HALF_PIXEL], [0.0, 0.0, 1.0]])


@contextlib.contextmanager
def writable(path: Path, target: Path) -> Iterator[Any]:
    """Open the database `target`, and close it; OutputError, about `path`, if pycolmap cannot write it."""
    import pycolmap

    database = pycolmap.Database.open(target)
    try:
        yield database
    except RuntimeError as error:
        raise OutputError(f"{path}: pycolmap cannot write it: {error}") from error
    finally:
        database.close()


def check_colmap_output(path: Path) -> ModuleType:
    """Return pycolmap, or raise OutputError, before any work is done, where `path` can never be written."""
    pycolmap = require("pycolmap", f"{path}: a COLMAP database")
    check_output(path)
    if path.exists():
        raise OutputError(f"{path}: exists already; a database is not overwritten")
    return pycolmap


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


def colmap_name(path: Path, root: Path) -> str:
    """Return what COLMAP calls an image: its path relative to a folder; ImageError if a database cannot hold it."""
    name = path.relative_to(root).as_posix()
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise ImageError(f"{path}: its name is not UTF-8, a COLMAP database cannot hold it: rename it") from error
    return name


def is_turned(path: Path) -> bool:
    """Return whether the EXIF data of an image turn it; ImageError if it cannot be read."""
    # An eighth of the size suffices: what is turned has other sides or other pixels.
    stored = read_image(path, cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    content = path.read_bytes()
    tagged = content[:2] in (b"II", b"MM") or any(tag in content for tag in _EXIF)  # the first are of TIFF
    return tagged and not np.array_equal(stored, read_image(path, cv2.IMREAD_REDUCED_GRAYSCALE_8))


def add_camera(database: Any, camera: Any) -> int:
    """Write a camera of pycolmap, and its own rig, which has its number; return the number."""
    import pycolmap

    camera.camera_id = database.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(camera.sensor_id)
    rig.rig_id = camera.camera_id
    database.write_rig(rig, use_rig_id=True)
    return int(camera.camera_id)


def add_image(database: Any, name: str, camera_id: int, keypoints: FloatArray) -> int:
    """Write an image of a camera that `add_camera` wrote, its frame, and its keypoints (N, 2); return its number."""
    import pycolmap

    image_id: int = database.write_image(pycolmap.Image(name=name, camera_id=camera_id))
    frame = pycolmap.Frame()
    frame.rig_id = camera_id
    frame.add_data_id(database.read_image(image_id).data_id)
    database.write_frame(frame)
    database.write_keypoints(image_id, (keypoints + _HALF_PIXEL).astype(np.float32))
    return image_id


def add_pair(
    database: Any,
    ids: tuple[int, int],
    matches: IntArray,
    *,
    inliers: int = 0,
    configuration: str = "",
    F: FloatArray | None = None,
    H: FloatArray | None = None,
    E: FloatArray | None = None,
) -> None:
    """Write the matches (M, 2) of a pair of images, and a geometry of COLMAP's `configuration` for the first of them.

    What the database holds for the pair is replaced. `matches` are rows of the keypoints, each once per image.
    """
    import pycolmap

    if database.exists_matches(*ids):
        database.delete_matches(*ids)
    if database.exists_two_view_geometry(*ids):
        database.delete_two_view_geometry(*ids)
    rows = matches.astype(np.uint32)
    database.write_matches(*ids, rows)
    if not configuration:
        return
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = pycolmap.TwoViewGeometryConfiguration.__members__[configuration]
    geometry.F = None if F is None else fundamental_for_colmap(F)
    geometry.H = None if H is None else homography_for_colmap(H)
    geometry.E = E
    geometry.inlier_matches = rows[:inliers]
    database.write_two_view_geometry(*ids, geometry)


def intrinsics_of(camera: Any) -> Intrinsics:
    """Return what a camera of pycolmap tells, in our pixels."""
    K = camera.calibration_matrix()
    K[:2, 2] -= _HALF_PIXEL

    def undistort(x: FloatArray) -> FloatArray:
        return np.asarray(camera.cam_from_img(x + _HALF_PIXEL) * (K[0, 0], K[1, 1]) + K[:2, 2])

    return Intrinsics(K=K, undistort=None if camera.is_undistorted() else undistort)


def configuration_of(estimate: FundamentalEstimate) -> str:
    """Return COLMAP's name for the geometry of an estimate; empty where there is none."""
    if estimate:
        return "UNCALIBRATED" if estimate.E is None else "CALIBRATED"
    return _CONFIGURATIONS[estimate.geometry] if estimate.H is not None else ""


def fundamental_for_colmap(F: FloatArray) -> FloatArray:
    """Return `F`, shape (3, 3), for points half a pixel further right and down: COLMAP's pixels."""
    return np.asarray(_TO_OURS.T @ F @ _TO_OURS)


def homography_for_colmap(H: FloatArray) -> FloatArray:
    """Return `H`, shape (3, 3), which maps image 1 to image 2, for COLMAP's pixels."""
    return np.asarray(np.linalg.inv(_TO_OURS) @ H @ _TO_OURS)
