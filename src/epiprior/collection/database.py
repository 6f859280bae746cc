"""A collection as a COLMAP database: a new one, or what is missing in one that COLMAP has filled with features."""

import contextlib
import copy
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from epiprior.collection.images import ImageSet, known_images
from epiprior.collection.verify import JudgedPairs
from epiprior.errors import FeatureError, ImageError, SettingsError, require
from epiprior.io.colmap import add_camera, add_image, add_pair, check_colmap_output, writable
from epiprior.io.features import read_colmap_features
from epiprior.io.output import replacing
from epiprior.types import Features

CameraMode = Literal["single", "per-folder", "per-image"]
_MOST_IMAGES = 2147483647  # COLMAP numbers a pair by image1 * this + image2


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """The cameras of a new database.

    Parameters are separated by commas, as COLMAP takes them. Without them the focal length is as COLMAP infers it, from
    EXIF or 1.2 times the longer side.
    """

    mode: CameraMode = "per-image"  # which images share one: all, those of a folder, or none
    model: str = "SIMPLE_RADIAL"  # COLMAP's name of a camera model
    params: str = ""


def infer_cameras(images: ImageSet, how: CameraSettings) -> list[tuple[str, Any]]:
    """Return for each image who shares its camera, and pycolmap's camera: the first image of a group decides.

    ImageError if COLMAP cannot read an image, or images that share a camera have different sizes; SettingsError if
    there is no such model, or it has other parameters.
    """
    import pycolmap

    options = pycolmap.ImageReaderOptions()
    options.camera_model = how.model
    if how.model not in pycolmap.CameraModelId.__members__ or how.model == "INVALID":
        known = ", ".join(name for name in pycolmap.CameraModelId.__members__ if name != "INVALID")
        raise SettingsError(f"camera model {how.model!r}, known: {known}")
    cameras: dict[str, tuple[str, Any]] = {}
    shared = []
    for image in images.images:
        assert image.path is not None
        try:
            camera = pycolmap.infer_camera_from_image(image.path, options)
        except (ValueError, RuntimeError) as error:
            raise ImageError(f"{image.path}: COLMAP cannot read it: {error}") from error
        if how.params:
            if not camera.set_params_from_string(how.params):
                raise SettingsError(f"camera parameters {how.params!r}: {how.model} has {camera.params_info}")
            camera.has_prior_focal_length = True
        group = {"single": "", "per-folder": image.name.rpartition("/")[0], "per-image": image.name}[how.mode]
        first, known_camera = cameras.setdefault(group, (image.name, camera))
        if (camera.width, camera.height) != (known_camera.width, known_camera.height):
            sizes = f"{camera.width} x {camera.height}, {first}, of the same camera, {known_camera.width} x "
            raise ImageError(f"{image.path}: is {sizes}{known_camera.height}; set --camera-mode per-image")
        shared.append((first, known_camera))
    return shared


def write_database(path: Path, judged: JudgedPairs, cameras: Sequence[tuple[str, Any]]) -> int:
    """Write a new database with the pairs that are relied on; return how many have a geometry.

    Focal lengths that pairs contradict are not written as prior ones. OutputError if it exists, also if it was made
    meanwhile, or cannot be written; the file appears as a whole.
    """
    pycolmap = check_colmap_output(path)
    matched = judged.matched
    with replacing(path) as scratch:
        with writable(path, scratch) as database:
            numbers: dict[str, int] = {}
            ids: dict[str, int] = {}
            with pycolmap.DatabaseTransaction(database):
                for place, (image, (first, camera)) in enumerate(zip(matched.images.images, cameras, strict=True)):
                    if first not in numbers:
                        own = copy.copy(camera)  # pairs are looked up by the other
                        own.has_prior_focal_length &= judged.trusted
                        numbers[first] = add_camera(database, own)
                    ids[image.name] = add_image(database, image.name, numbers[first], matched.features(place).xy)
            count = _add_pairs(database, judged, ids)
        check_colmap_output(path)
    return count


def extend_database(path: Path, judged: JudgedPairs) -> int:
    """Add the pairs that are relied on to a database that holds the features; return how many have a geometry.

    After a kill the database is as it was; after an error it holds the pairs before it, and may be extended again.
    Pairs that it had before contradict none.
    """
    with writable(path, path) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        return _add_pairs(database, judged, ids)


def _add_pairs(database: Any, judged: JudgedPairs, ids: dict[str, int]) -> int:
    import pycolmap

    count = 0
    with pycolmap.DatabaseTransaction(database):
        for pair, why_not in judged:
            if why_not:
                continue
            how: dict[str, Any] = {"configuration": pair.geometry, "F": pair.F, "H": pair.H, "E": pair.E}
            both = ids[pair.image1], ids[pair.image2]
            add_pair(database, both, pair.matches, inliers=len(pair.matches), **how)
            count += 1
    return count


@dataclass(frozen=True, kw_only=True)
class FilledDatabase:
    """A database that COLMAP has filled: its images, their features, and the pairs that have a geometry already."""

    images: ImageSet
    features: Callable[[str], Features]
    verified: frozenset[tuple[str, str]]
    cameras: Mapping[str, Any]


def read_filled(path: Path, folder: Path | None, *, roots: int = 1) -> FilledDatabase:
    """Read what `match_collection` needs from a database of COLMAP; `folder` holds its photographs, if at hand.

    Without photographs the descriptors of the features serve for all. FeatureError if it is no such database, or an
    image has no features; ImageError if a photograph is missing.
    """
    pycolmap = require("pycolmap", f"{path}: a COLMAP database", FeatureError)
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as opened:
            names = dict(opened.execute("SELECT image_id, name FROM images ORDER BY name"))
            bare = "SELECT name FROM images WHERE image_id NOT IN (SELECT image_id FROM descriptors) ORDER BY name"
            missing = [name for (name,) in opened.execute(bare)]
            numbers = [pair for (pair,) in opened.execute("SELECT pair_id FROM two_view_geometries WHERE rows > 0")]
    except sqlite3.Error as error:
        raise FeatureError(f"{path}: exists already, and is no COLMAP database: {error}") from error
    if missing or not names:
        what = f"{missing[0]} has no descriptors" if missing else "there are no images in it"
        raise FeatureError(f"{path}: exists already, but {what}: run COLMAP's feature extraction, or name a new file")
    pairs = (divmod(number, _MOST_IMAGES) for number in numbers)
    verified = frozenset((min(names[a], names[b]), max(names[a], names[b])) for a, b in pairs)
    images = known_images(list(names.values()), folder, path)
    try:
        with pycolmap.Database.open(path) as opened:
            cameras = {image.name: opened.read_camera(image.camera_id) for image in opened.read_all_images()}
    except RuntimeError as error:
        raise FeatureError(f"{path}: pycolmap cannot open it, for which it must be writable: {error}") from error
    features = partial(read_colmap_features, path, roots=roots)
    return FilledDatabase(images=images, features=features, verified=verified, cameras=cameras)
