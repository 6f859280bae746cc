"""Features by location: those that differ only in orientation, twins, are one location."""

from dataclasses import dataclass

import numpy as np

from epiprior.features.images import Photograph
from epiprior.types import Features, FloatArray, IntArray


def unique_locations(features: Features) -> tuple[IntArray, IntArray]:
    """Find the features that differ only in orientation: at a fixed orientation these twins are identical.

    Returns the index of the first feature of each (location, scale), (L,), ascending: the detector's strongest; and for
    each feature, (N,), the index into these of its (location, scale).
    """
    if not len(features):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    key = np.column_stack([features.xy, features.scale])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    return first[order].astype(np.int64), np.argsort(order)[inverse.reshape(-1)]


@dataclass(frozen=True)
class Locations:
    """Features of one image, grouped by (location, scale)."""

    xy: FloatArray  # (L, 2), working pixels
    scale: FloatArray  # (L,), sigma, working pixels
    first: IntArray  # (L,), first feature of each location
    of_feature: IntArray  # (N,), location of each feature
    twins: IntArray  # (N,), features of location l are twins[start[l]:start[l + 1]]
    start: IntArray


def locate(features: Features, working: Photograph) -> Locations:
    """Group the features of an image; `working` gives its change of coordinates."""
    first, of_feature = unique_locations(features)
    twins = np.argsort(of_feature, kind="stable").astype(np.int64)
    start = np.searchsorted(of_feature[twins], np.arange(len(first) + 1)).astype(np.int64)
    xy, scale = working.to_working(features.xy)[first], features.scale[first] / working.factor
    return Locations(xy, scale, first, of_feature, twins, start)
