"""Steps 1 to 3a on a pair: features, standard matches, roll hypotheses (paper, sections 4.1 and 4.2)."""

import hashlib
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from epiprior.errors import FeatureError, ImageError
from epiprior.features.describe import normalise_descriptors
from epiprior.features.detect import detect_features
from epiprior.features.images import Photograph, View, blank_photograph, load_photograph
from epiprior.features.locations import Locations, locate
from epiprior.kernels.parallel import in_threads
from epiprior.matching.standard import Neighbours, StandardTable, mutual_mask, nearest_neighbours, standard_table
from epiprior.presets import DEFAULT, PreprocessSettings
from epiprior.types import Features, Float32Array, FloatArray, IntArray, MatchSet

_GRID = 720  # angles at which the density of rolls is computed


class Stopwatch:
    """Wall time per named step; a step that is repeated adds up."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time the body of a with statement."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def share(self, seconds: float, watches: Sequence["Stopwatch"]) -> None:
        """Add what others measured at the same time: their steps share these `seconds` of wall time in proportion."""
        total = sum(sum(watch.seconds.values()) for watch in watches)
        for watch in watches:
            for name, own in watch.seconds.items():
                self.seconds[name] = self.seconds.get(name, 0.0) + seconds * own / total


@dataclass(frozen=True, kw_only=True)
class PreparedPair:
    """Features of both images and their nearest neighbours: all that does not depend on the roll."""

    photographs: tuple[Photograph | None, Photograph | None]  # working images; None for one not handed in
    features: tuple[Features, Features]  # as detected or handed in
    descriptors: tuple[Float32Array, Float32Array]  # unit length, at the features' own orientation
    to_working: tuple[FloatArray, FloatArray]  # (3, 3), affine, from pixels of the images as given to working pixels
    locations: tuple[Locations, Locations]  # features grouped by location and scale
    forward: Neighbours  # of the features of image 1 in image 2
    backward: Neighbours  # of the features of image 2 in image 1
    table: StandardTable  # X_L and X_B by location
    turned: bool = False  # image 1 here is image 2 as given

    def as_given(self, matches: MatchSet) -> MatchSet:
        """Return matches of this pair with the images in the order as given."""
        return matches.swapped() if self.turned else matches

    def matches_of(self, rows1: IntArray, rows2: IntArray, **columns: Any) -> MatchSet:
        """Return matches of the features `rows1` of image 1 with `rows2` of image 2; `columns` are all others."""
        (f1, f2), (place1, place2) = self.features, self.locations
        return MatchSet(
            x1=f1.xy[rows1],
            x2=f2.xy[rows2],
            scale1=f1.scale[rows1],
            scale2=f2.scale[rows2],
            feature1=place1.first[place1.of_feature[rows1]],
            feature2=place2.first[place2.of_feature[rows2]],
            image_sizes=(f1.image_size, f2.image_size),
            **columns,
        )


def prepare_pair(
    image1: View | None,
    image2: View | None,
    settings: PreprocessSettings = DEFAULT,
    *,
    features1: Features | None = None,
    features2: Features | None = None,
    watch: Stopwatch | None = None,
    ordered: bool = False,
) -> PreparedPair:
    """Find features and standard matches (section 4.1); ImageError and FeatureError name the image they are about.

    An image may be None only where features (pixels of the image as given) are handed in; then their own descriptors
    also serve where the method asks for descriptors at a fixed orientation, and repeated corners are told apart less
    well. `watch` takes the seconds of the steps. Where `ordered`, the images are taken in an order that their features
    decide, so that the matches are the same whichever is given first.
    """
    watch = watch or Stopwatch()
    limit, how = settings.features.max_image_size, settings.features
    images, given = (image1, image2), (features1, features2)
    for k, (image, own) in enumerate(zip(images, given, strict=True), start=1):
        if image is None and own is None:
            raise ImageError(f"image {k} is None and no features were handed in for it")

    def find(k: int) -> tuple[Photograph | None, Features]:
        image, own = images[k], given[k]
        photograph = None if image is None else load_photograph(image, limit)
        if own is None:
            assert photograph is not None
            own = detect_features(photograph, how)
        elif not isinstance(own, Features):
            raise FeatureError(f"features of image {k + 1} are {type(own).__name__}, expected epiprior.Features")
        elif photograph is not None and own.image_size != photograph.size:
            raise FeatureError(
                f"features of image {k + 1} belong to an image of {own.image_size}, the image is {photograph.size}"
            )
        return photograph, own

    with watch.step("features"):
        (photo1, own1), (photo2, own2) = in_threads(find, (0, 1))
    if own1.descriptors.shape[1] != own2.descriptors.shape[1]:
        raise FeatureError(
            f"descriptors have {own1.descriptors.shape[1]} and {own2.descriptors.shape[1]} entries, expected the same"
        )
    turned = ordered and in_other_order(own1, own2)
    if turned:
        photo1, own1, photo2, own2 = photo2, own2, photo1, own1
    with watch.step("standard matches"):
        d1, d2 = (normalise_descriptors(f.descriptors, root=how.root, centred=how.centred) for f in (own1, own2))
        forward, backward = nearest_neighbours(d1, d2)
        working1 = photo1 or blank_photograph(own1.image_size, limit)
        working2 = photo2 or blank_photograph(own2.image_size, limit)
        place1, place2 = locate(own1, working1), locate(own2, working2)
        location_of = (place1.of_feature, place2.of_feature)
        table = standard_table(forward, backward, location_of, settings.max_distance_ratio)
    return PreparedPair(
        photographs=(photo1, photo2),
        features=(own1, own2),
        descriptors=(d1, d2),
        to_working=(working1.working_map, working2.working_map),
        locations=(place1, place2),
        forward=forward,
        backward=backward,
        table=table,
        turned=turned,
    )


def in_other_order(features1: Features, features2: Features) -> bool:
    """Return whether the order that features decide is the other one."""
    keys = (hashlib.blake2b(one.xy.tobytes() + one.scale.tobytes()).digest() for one in (features1, features2))
    return next(keys) > next(keys)


def roll_hypotheses(prepared: PreparedPair, settings: PreprocessSettings = DEFAULT) -> tuple[float, ...]:
    """Return the roll hypotheses alpha_exp and 0, degrees (section 4.2); one where they nearly agree."""
    # X_L and X_B decide alpha_exp.
    forward = prepared.forward
    mask = mutual_mask(forward, prepared.backward) | (forward.distance_ratio <= settings.max_distance_ratio)
    rows = np.flatnonzero(mask & (forward.nearest >= 0))
    first, second = prepared.features
    differences = orientation_differences(first.orientation_deg[rows], second.orientation_deg[forward.nearest[rows]])
    expected = expected_roll(differences, settings.roll_bandwidth_deg)
    return (0.0,) if abs(expected) <= settings.merge_rolls_deg and settings.merge_rolls_deg > 0 else (expected, 0.0)


def orientation_differences(orientation1_deg: FloatArray, orientation2_deg: FloatArray) -> FloatArray:
    """Return orientation 2 minus orientation 1, degrees in [0, 360): the roll of image 2 by each match alone."""
    return np.asarray(np.mod(orientation2_deg - orientation1_deg, 360.0))


def roll_density(differences_deg: FloatArray, bandwidth_deg: float = 7.0) -> tuple[FloatArray, FloatArray]:
    """Return 720 angles in degrees, half a degree apart, and the circular kernel density of the differences there.

    The von Mises kernel has a concentration of one over the squared `bandwidth_deg` in radians. The density is per
    degree, integrates to 1 over the circle, and is uniform without any match.
    """
    angles = np.arange(_GRID, dtype=np.float64) * (360.0 / _GRID)
    if not len(differences_deg):
        return angles, np.full(_GRID, 1 / 360.0)
    histogram = np.bincount(np.rint(differences_deg * (_GRID / 360.0)).astype(np.int64) % _GRID, minlength=_GRID)
    kernel = np.exp((np.cos(np.deg2rad(angles)) - 1) / np.deg2rad(bandwidth_deg) ** 2)
    density: FloatArray = np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), _GRID)
    return angles, density / (density.sum() * 360.0 / _GRID)


def expected_roll(differences_deg: FloatArray, bandwidth_deg: float = 7.0) -> float:
    """Return alpha_exp, the highest peak of `roll_density`, degrees in (-180, 180]; 0 without any match."""
    if not len(differences_deg):
        return 0.0
    angles, density = roll_density(differences_deg, bandwidth_deg)
    # Rounding keeps the choice between equal peaks independent of the last bits of the transform.
    peak = float(angles[np.round(density, 12).argmax()])
    return peak if peak <= 180.0 else peak - 360.0
