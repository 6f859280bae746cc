"""Features that other programs have found: those of a COLMAP database, those of an h5 file of hloc.

Both presets expect SIFT as Lowe describes it, of whose entries `default` takes the root itself (RootSIFT), `paper` does
not. COLMAP and hloc store roots already. So the roots are undone here: an entry is raised to the power two once per
root; the descriptor's length does not matter.
"""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError, require
from epiprior.types import Features, Float32Array, FloatArray

_HALF_PIXEL = 0.5  # COLMAP has the centre of the top-left pixel there
_HLOC_FRAMES = ("scales", "oris")
_HLOC_PARTS = ("keypoints", "descriptors", "image_size", *_HLOC_FRAMES)
_COLMAP_TABLES = frozenset({"cameras", "images", "keypoints", "descriptors"})
_ENTRY_BYTES = {"keypoints": 4, "descriptors": 1}


def read_colmap_features(database: str | Path, image_name: str, *, roots: int = 1) -> Features:
    """Read the features of one image from a COLMAP database.

    COLMAP does not turn an image by its EXIF orientation, epiprior does: such an image is to be saved upright before
    COLMAP sees it. Pycolmap always opens a database for writing: it marks the file with its version, and brings the
    tables of an older COLMAP to its own schema.

    Parameters
    ----------
    database : A database that ``colmap feature_extractor`` or pycolmap has written.
    image_name : Name of the image in the database: its path relative to COLMAP's image folder.
    roots : How many times the root was taken of the entries of the stored descriptors, >= 0: 1 for COLMAP's default
        normalisation ``L1_ROOT``, 0 for ``L2``. The database does not say which.

    Returns
    -------
    Locations in pixels, the centre of the top-left pixel at (0, 0): half a pixel less than COLMAP's. Scale is sigma in
    pixels; of an affine frame the mean of its two. Orientation is in degrees; of an affine frame that of its first
    axis. The size of the image is that of its camera. Empty if COLMAP found none.

    Raises
    ------
    FeatureError : If pycolmap is not installed, the file is missing, no COLMAP database or not writable, the image is
        not in it, or its features are missing, are locations only (as in databases of ``epiprior colmap``), or are not
        described by SIFT; the message names the file.
    """
    database = Path(database)
    pycolmap = require("pycolmap", f"{database}: a COLMAP database", FeatureError)
    where = f"{database}: image {image_name!r}"
    _check_is_colmap(database, image_name)
    try:
        with closing(pycolmap.Database.open(database)) as opened:
            image = opened.read_image_with_name(image_name)
            if image is None:
                raise FeatureError(f"{database}: has no image {image_name!r} among its {opened.num_images()} images")
            if not (opened.exists_keypoints(image.image_id) and opened.exists_descriptors(image.image_id)):
                raise FeatureError(f"{where} has no keypoints or no descriptors; run COLMAP's feature extraction first")
            keypoints = np.asarray(opened.read_keypoints(image.image_id), dtype=np.float64)
            descriptors = opened.read_descriptors(image.image_id)
            camera = opened.read_camera(image.camera_id)
    except RuntimeError as error:
        raise FeatureError(f"{database}: pycolmap cannot open it, for which it must be writable: {error}") from error
    known = (pycolmap.FeatureExtractorType.SIFT, pycolmap.FeatureExtractorType.UNDEFINED)
    if descriptors.type not in known:
        raise FeatureError(f"{where} is described by {descriptors.type.name}, epiprior needs SIFT")
    xy, scale, orientation = _colmap_frames(where, keypoints)
    plain, size = _without_roots(where, np.asarray(descriptors.data), roots), (camera.width, camera.height)
    frames = {"xy": xy - _HALF_PIXEL, "scale": scale, "orientation_deg": np.rad2deg(orientation)}
    return _features(where, **frames, descriptors=plain, image_size=size)


def read_hloc_features(path: str | Path, image_name: str, *, roots: int = 2) -> Features:
    """Read the features of one image from an h5 file of hloc, or of the same layout.

    Two flaws of such files stay, so that F belongs to the locations that hloc works with. Its ``dog`` writes COLMAP's
    locations without taking their half pixel off: they lie half a pixel, of the size at which hloc extracted, too far
    right and down. And hloc rounds to float16 unless told ``as_half=False``: to whole pixels beyond 1024.

    Parameters
    ----------
    path : The file. The group of an image holds ``keypoints`` (N, 2), ``descriptors`` (D, N), ``image_size`` (2,),
        ``scales`` (N,) and ``oris`` (N,): hloc's extractor ``dog``, its configuration ``sift``, writes them all.
    image_name : Name of the group: the image's path relative to hloc's image folder.
    roots : How many times the root was taken of the entries of the stored descriptors, >= 0. 2 for the ``rootsift`` of
        hloc's ``dog``, which takes the root of what COLMAP has taken the root of; 1 for a RootSIFT of one's own; 0 for
        its ``sift``, and for descriptors that are not SIFT.

    Returns
    -------
    Locations as the file has them, pixels: hloc's too have the centre of the top-left pixel at (0, 0), it adds half a
    pixel only when it hands them to COLMAP. ``scales`` are sigma in pixels, ``oris`` degrees clockwise on the screen.

    Raises
    ------
    FeatureError : If h5py is not installed, the file is missing or no h5 file, the image is not in it, a part of its
        features is missing (learned detectors have no scale and orientation), or entries of which the root was taken
        are negative; the message names the file.
    """
    path = Path(path)
    h5py = require("h5py", f"{path}: an h5 file", FeatureError)
    _check_is_file(path)
    try:
        with h5py.File(path, "r") as file:
            group = file.get(image_name)
            if not isinstance(group, h5py.Group):
                raise FeatureError(f"{path}: has no image {image_name!r} among its {len(hloc_names(file))} images")
            items = {name: group.get(name) for name in _HLOC_PARTS}
            data = {name: np.asarray(item) for name, item in items.items() if isinstance(item, h5py.Dataset)}
    except (OSError, RuntimeError) as error:
        raise FeatureError(f"{path}: not an h5 file that can be read: {error}") from error
    where = f"{path}: image {image_name!r}"
    for name, value in data.items():
        if value.dtype.kind not in "iuf":
            raise FeatureError(f"{where}: {name} is of type {value.dtype}, expected numbers")
    missing = [name for name in _HLOC_PARTS if name not in data]
    if missing:
        why = ": epiprior needs the scale and the orientation of each feature, which learned features lack; hloc's "
        why = "" if set(missing) - set(_HLOC_FRAMES) else f"{why}configuration 'sift' writes them"
        raise FeatureError(f"{where} has no {', '.join(missing)}{why}")
    plain, size = _without_roots(where, data["descriptors"].T, roots), tuple(data["image_size"].ravel().tolist())
    frames = {"xy": data["keypoints"], "scale": data["scales"], "orientation_deg": data["oris"]}
    return _features(where, **frames, descriptors=plain, image_size=size)


def hloc_names(file: Any) -> list[str]:
    """Return the images that an open file of hloc has keypoints of, by name."""
    names: list[str] = []
    file.visit(names.append)
    return sorted(name.rpartition("/")[0] for name in names if name.endswith("/keypoints"))


def _check_is_file(path: Path) -> None:
    if not path.is_file():
        raise FeatureError(f"{path}: is a folder, not a file" if path.is_dir() else f"{path}: no such file")


def _check_is_colmap(database: Path, image_name: str) -> None:
    """Raise FeatureError unless COLMAP's tables are there, and the image's numbers fill the rows they are said to have.

    Pycolmap would add the tables to any other database.
    """
    _check_is_file(database)
    try:
        with closing(sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True)) as opened:
            tables = {name for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            missing = sorted(_COLMAP_TABLES - tables)
            if missing:
                raise FeatureError(f"{database}: not a COLMAP database: no table {', '.join(missing)}")
            for table, width in _ENTRY_BYTES.items():
                query = f"SELECT rows, cols, length(data) FROM {table} NATURAL JOIN images WHERE name = ?"
                for rows, columns, size in opened.execute(query, (image_name,)):
                    if rows * columns * width != (size or 0):
                        raise FeatureError(
                            f"{database}: image {image_name!r}: its {table} hold {size or 0} bytes, expected "
                            f"{rows * columns * width}: {rows} rows of {columns}, {width} bytes each"
                        )
    except sqlite3.Error as error:
        raise FeatureError(f"{database}: not a COLMAP database: {error}") from error


def _colmap_frames(where: str, keypoints: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return location, scale (pixels) and orientation (radians) of COLMAP's rows, in COLMAP's pixels."""
    columns = keypoints.shape[1]
    if columns == 4:
        return keypoints[:, :2], keypoints[:, 2], keypoints[:, 3]
    if columns == 6:
        a11, a12, a21, a22 = keypoints[:, 2:].T
        return keypoints[:, :2], (np.hypot(a11, a21) + np.hypot(a12, a22)) / 2, np.arctan2(a21, a11)
    raise FeatureError(
        f"{where} has keypoints of {columns} columns, expected 4 or 6: epiprior needs the scale and the orientation of "
        "each feature, not its location only"
    )


def _without_roots(where: str, descriptors: NDArray[Any], roots: int) -> Float32Array:
    """Return descriptors, shape (N, D), as they were before the root of their entries was taken `roots` times."""
    if roots < 0:
        raise FeatureError(f"roots is {roots}, must be at least 0")
    plain = np.asarray(descriptors, dtype=np.float32)
    if roots and plain.size and float(plain.min()) < 0:
        raise FeatureError(f"{where} has negative descriptor entries, which are no roots: not SIFT; see roots=0")
    for _ in range(roots):
        plain = np.square(plain)
    return plain


def _features(where: str, *, orientation_deg: NDArray[Any], **parts: Any) -> Features:
    """Return Features, or raise FeatureError that says where the parts are from."""
    try:
        angle = np.mod(np.asarray(orientation_deg, dtype=np.float64), 360.0)
        return Features(orientation_deg=angle, **parts)
    except FeatureError as error:
        raise FeatureError(f"{where}: {error}") from error
