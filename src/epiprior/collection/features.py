"""Features of the photographs of a collection, found once, on disk.

A file holds the features of one image and their descriptors at the roll hypothesis 0, under a key of all that they
depend on. A pair then decodes a photograph only under another roll hypothesis.
"""

import hashlib
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.collection.images import CollectionImage, read_mask
from epiprior.collection.workers import installation
from epiprior.errors import FeatureError, ImageError
from epiprior.features.describe import describe_at_orientation, remember_description
from epiprior.features.detect import detect_features
from epiprior.features.images import Photograph, blank_photograph, load_photograph
from epiprior.features.locations import unique_locations
from epiprior.presets import FeatureSettings
from epiprior.types import Features, Float32Array, IntArray


def feature_key(image: CollectionImage, settings: FeatureSettings, given: Features | None = None) -> str:
    """Return what the features of an image depend on: its bytes, those of its mask, settings, and this installation.

    Where features are `given`, they stand in for the first two.
    """
    parts = [image.digest, repr(settings), installation()]
    if given is not None:
        columns = (given.xy, given.scale, given.orientation_deg, given.descriptors)
        parts += [repr(given.image_size), *(hashlib.sha256(column.tobytes()).hexdigest() for column in columns)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def make_features(image: CollectionImage, settings: FeatureSettings, given: Features | None = None) -> bytes:
    """Return the contents of the file of an image: a task.

    `given` features are described at the roll hypothesis 0 where there is a photograph; FeatureError, which names the
    image, if they lie outside, or belong to an image of another size.
    """
    photograph = None if image.path is None else _load(image, settings.max_image_size)
    features = given
    if features is None:
        assert photograph is not None
        features = detect_features(photograph, settings)
    columns = {name: getattr(features, name) for name in ("xy", "scale", "orientation_deg", "descriptors")}
    if photograph is not None:
        if features.image_size != photograph.size:
            raise FeatureError(f"{image.path}: is {photograph.size}, its features are of {features.image_size}")
        try:
            located = features.take(unique_locations(features)[0])
            columns["fixed"] = describe_at_orientation(photograph, located, 0.0)
        except FeatureError as error:
            raise FeatureError(f"{image.path}: {error}") from error
    file = io.BytesIO()
    packed: dict[str, Any] = {name: _packed(value) for name, value in columns.items()}
    np.savez(file, size=np.array(features.image_size), **packed)
    return file.getvalue()


def _packed(value: NDArray[np.floating]) -> NDArray[np.generic]:
    """Return whole numbers up to 255, as SIFT's descriptors are, as bytes."""
    if value.dtype != np.float32 or not value.size or value.min() < 0 or value.max() > 255:
        return value
    small = value.astype(np.uint8)
    return small if np.array_equal(small, value) else value


def _load(image: CollectionImage, limit: int) -> Photograph:
    assert image.path is not None
    mask = None if image.mask is None else read_mask(image.mask)
    return load_photograph(image.path, limit, turn=False, mask=mask)


@dataclass(frozen=True, kw_only=True)
class StoredFeatures:
    """What the file of an image holds."""

    features: Features
    fixed: Float32Array | None  # (L, 128), descriptors of its locations at the roll hypothesis 0

    @cached_property
    def first_rows(self) -> IntArray:
        """For each feature, (N,), the first at the very same place (float32): the keypoint that matches name."""
        xy = self.features.xy.astype(np.float32)
        _, first, inverse = np.unique(xy, axis=0, return_index=True, return_inverse=True)
        return np.asarray(first[inverse.reshape(-1)], dtype=np.int64)

    def view(self, image: CollectionImage, settings: FeatureSettings) -> Photograph | None:
        """Return the photograph, not decoded; it remembers its descriptors at the roll hypothesis 0."""
        if self.fixed is None:
            return None
        blank = blank_photograph(self.features.image_size, settings.max_image_size)
        view = replace(blank, name=str(image.path), decode=lambda: _load(image, settings.max_image_size).grey)
        located = self.features.take(unique_locations(self.features)[0])
        remember_description(view, located, 0.0, self.fixed)
        return view


def read_features(path: Path) -> StoredFeatures:
    """Read a file that holds what `make_features` returned; ImageError names one that cannot be read."""
    try:
        with np.load(path) as data:
            columns = {name: data[name] for name in data.files}
    except (OSError, ValueError, EOFError) as error:
        raise ImageError(f"{path}: the features cannot be read, delete the file: {error}") from error
    fixed = columns.pop("fixed", None)
    size = tuple(columns.pop("size").tolist())
    features = Features(image_size=size, **columns)
    return StoredFeatures(features=features, fixed=None if fixed is None else fixed.astype(np.float32))
