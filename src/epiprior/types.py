"""The values that pass between the steps of the method.

Conventions, everywhere: points are ``(N, 2)`` float64 pixels of the image as given, the centre of the top-left pixel at
(0, 0); ``x2' F x1 = 0``; residuals are unsquared pixels; scale is the sigma of the feature in pixels; public angles are
degrees, clockwise as seen on the screen (y points down), in [0, 360).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epiprior.errors import FeatureError
from epiprior.kernels.one_to_one import one_to_one_mask

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ImageSizes = tuple[tuple[float, float], tuple[float, float]]

EMPTY_MAPPING: Mapping[str, Any] = MappingProxyType({})


def as_numbers(name: str, value: Any, dtype: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
    """Return `value` as a contiguous array of numbers; FeatureError, which names it, if it is none."""
    try:
        return np.ascontiguousarray(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise FeatureError(f"{name} is not an array of numbers: {error}") from error


def check_array(name: str, value: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    """Raise FeatureError unless `value` has `shape` (None: any length) and holds only finite numbers."""
    if value.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, value.shape, strict=True)):
        wanted = ", ".join("N" if want is None else str(want) for want in shape)
        raise FeatureError(f"{name} has shape {value.shape}, expected ({wanted})")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        bad = int(np.flatnonzero(~np.isfinite(value).reshape(len(value), -1).all(axis=1))[0])
        raise FeatureError(f"{name} holds a NaN or infinite value, first in row {bad}")


def _size_of(value: Any) -> tuple[int, int]:
    """Return `value` as width and height, or raise FeatureError."""
    try:
        width, height = (int(side) for side in value)
    except (TypeError, ValueError, OverflowError):
        width = height = 0
    if min(width, height) < 1:
        raise FeatureError(f"features: image_size is {value!r}, expected a width and a height of at least one pixel")
    return width, height


@dataclass(frozen=True, kw_only=True)
class Features:
    """Local features of one image (paper, section 4.1).

    Parameters
    ----------
    xy : (N, 2) float64. Locations, pixels.
    scale : (N,) float64. Sigma, pixels, > 0. OpenCV's keypoint ``size`` is two sigma.
    orientation_deg : (N,) float64. Orientation, degrees in [0, 360).
    descriptors : (N, D) float32. At the features' own orientation; for SIFT as OpenCV gives them, not normalised.
    image_size : Width and height of the image, pixels, > 0.

    Raises
    ------
    FeatureError : If shapes disagree, a value is not finite, or a scale or a side of the image is not positive.
    """

    xy: FloatArray
    scale: FloatArray
    orientation_deg: FloatArray
    descriptors: Float32Array
    image_size: tuple[int, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "image_size", _size_of(self.image_size))
        n: int | None = None
        widths: tuple[tuple[int | None, ...], ...] = ((2,), (), (), (None,))
        for name, width in zip(("xy", "scale", "orientation_deg", "descriptors"), widths, strict=True):
            dtype = np.float32 if name == "descriptors" else np.float64
            value = as_numbers(f"features: {name}", getattr(self, name), dtype)
            check_array(f"features: {name}", value, (n, *width))
            object.__setattr__(self, name, value)
            n = len(value)
        if n and float(self.scale.min()) <= 0:
            raise FeatureError(
                f"features: scale must be positive, row {int(self.scale.argmin())} is {self.scale.min()}"
            )

    def __len__(self) -> int:
        return len(self.xy)

    def take(self, index: IntArray) -> Features:
        """Return the features at `index`, in that order."""
        names = ("xy", "scale", "orientation_deg", "descriptors")
        return replace(self, **{name: getattr(self, name)[index] for name in names})


@dataclass(frozen=True, kw_only=True)
class MatchSet:
    """Putative matches, one column per property, sorted best first.

    Parameters
    ----------
    x1, x2 : (N, 2) float64. Matched locations, pixels of the given images.
    scale1, scale2 : (N,) float64. Sigma of both features, pixels.
    orientation1_deg, orientation2_deg : (N,) float64. Orientation of both features, degrees.
    feature1, feature2 : (N,) int64. Index of the matched features, as found or handed in; a feature may take part in
        many matches. Features that differ only in orientation are one: all have the index of the first.
    probability : (N,) float64. Probability that the match is right, in [0, 1]; NaN for standard matches.
    supporting_matrices : (N,) int64. How many rough matrices the match supports: the paper's ``sfm`` (section 4.5).
    distance_ratio : (N,) float64. Ratio d_r of the angles to the two nearest descriptors (section 4.1); 1 if missing.
    similarity_weight : (N,) float64. Similarity weight t_k of BLOGS (section 4.1); 0 if missing.
    similarity : (N,) float64. Normalised cross-correlation of the descriptors at their own orientation, in [-1, 1].
    two_keypoint_probability : (N,) float64. Highest of the 2keypoint matches that hold it (section 4.4); 0 if none.
    roll_deg : The roll hypothesis alpha under which X was made (section 4.2), degrees.
    rough_matrices : (M, 3, 3) float64. The rough fundamental matrices that voted (section 4.5); standard matches: none.
    image_sizes : Width and height of both images, pixels; None if unknown.
    """

    x1: FloatArray
    x2: FloatArray
    scale1: FloatArray
    scale2: FloatArray
    orientation1_deg: FloatArray
    orientation2_deg: FloatArray
    feature1: IntArray
    feature2: IntArray
    probability: FloatArray
    supporting_matrices: IntArray
    distance_ratio: FloatArray
    similarity_weight: FloatArray
    similarity: FloatArray
    two_keypoint_probability: FloatArray
    roll_deg: float = 0.0
    rough_matrices: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)), repr=False)
    image_sizes: ImageSizes | None = None

    def __len__(self) -> int:
        return len(self.x1)

    def take(self, index: IntArray | BoolArray | slice) -> MatchSet:
        """Return the matches at `index` (indices, a mask or a slice), in that order."""
        columns = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name not in _NOT_COLUMNS}
        return replace(self, **columns)

    def swapped(self) -> MatchSet:
        """Return the same matches with the two images in the other order."""
        columns = {to: getattr(self, of) for pair in _SIDES for to, of in (pair, pair[::-1])}
        rough = np.ascontiguousarray(self.rough_matrices.transpose(0, 2, 1))
        sizes = None if self.image_sizes is None else self.image_sizes[::-1]
        return replace(self, **columns, rough_matrices=rough, image_sizes=sizes, roll_deg=0.0 - self.roll_deg)

    def one_to_one(self) -> MatchSet:
        """Walk down the ranking and drop every match whose feature, in either image, was used before."""
        return self.take(one_to_one_mask(self.feature1, self.feature2))


_SIDES = (("x1", "x2"), ("scale1", "scale2"), ("orientation1_deg", "orientation2_deg"), ("feature1", "feature2"))
_NOT_COLUMNS = frozenset({"roll_deg", "rough_matrices", "image_sizes"})


@dataclass(frozen=True, kw_only=True)
class RankedMatches:
    """What `rank_matches` returns.

    Parameters
    ----------
    sets : One per roll hypothesis (section 4.2), each sorted best first.
    standard : X_L, the baseline, ordered by distance ratio.
    seconds : Wall time per step.
    preset : Name of the preset.
    """

    sets: tuple[MatchSet, ...]
    standard: MatchSet
    seconds: Mapping[str, float]
    preset: str


class Status(StrEnum):
    """Outcome of an estimation."""

    OK = "ok"
    TOO_FEW_MATCHES = "too_few_matches"
    NO_MODEL = "no_model"
    DEGENERATE = "degenerate"


class Geometry(StrEnum):
    """What relates two images, as far as their matches tell."""

    GENERAL = "general"  # different views of something that is not flat: F
    PLANAR = "planar"  # of one plane,
    ROTATION = "rotation"  # by a camera that only turned or zoomed,
    IDENTICAL = "identical"  # of one picture: a homography, which leaves F undecided
    NONE = "none"  # nothing that can be told from chance


@dataclass(frozen=True, kw_only=True)
class FundamentalEstimate:
    """A fundamental matrix with the probability that it is right, or why there is none.

    Parameters
    ----------
    status : ``ok``: F, with at least the confidence that is asked for. ``degenerate``: a homography relates the images,
        and F is not determined. ``no_model``: no F, or one with a lower confidence. ``too_few_matches``.
    F : (3, 3) float64. ``x2' F x1 = 0``; rank 2, Frobenius norm 1, largest entry positive. None only where the
        estimator found none: whether to rely on it is what `status` and `confidence` say.
    x1, x2 : (N, 2) float64. The matches over which support was collected, pixels.
    inliers : (N,) bool. Which of them lie within the threshold of `F`; with an `H`, which lie near that.
    support : Number of inliers.
    confidence : Calibrated probability, in [0, 1], that F is right: that the Sampson distance (unsquared) of points
        all over what both images show is below 10 pixels in the mean, at working size. NaN without F.
    geometry : What relates the images, see `Geometry`.
    H : (3, 3) float64. The homography ``x2 ~ H x1`` of the kinds that have one, Frobenius norm 1; else None.
    E : (3, 3) float64. The essential matrix that `F` belongs to; None without known intrinsics.
    calibrated : The estimate on the same matches under known intrinsics, where these were given and a general F has
        a chance: its F comes from an essential matrix, and holds for points without distortion.
    iterations : Number of hypotheses, where the backend tells.
    estimator, version : Name in the registry, and the backend's package and version.
    roll_deg : The roll hypothesis of `F`, degrees.
    input : What the estimator was given: ``standard`` (X_L), ``generalized`` (instead, for `generalized-ransac`), or
        the preset that ranked the matches; empty if unknown.
    message : Why `status` is not ``ok``; empty otherwise.
    seconds : Wall time per step.
    """

    status: Status
    F: FloatArray | None
    x1: FloatArray
    x2: FloatArray
    inliers: BoolArray
    support: int
    estimator: str
    confidence: float = math.nan
    geometry: Geometry = Geometry.NONE
    H: FloatArray | None = None
    E: FloatArray | None = None
    calibrated: FundamentalEstimate | None = None
    version: str = ""
    iterations: int | None = None
    roll_deg: float = 0.0
    input: str = ""
    message: str = ""
    seconds: Mapping[str, float] = field(default_factory=lambda: EMPTY_MAPPING)

    def __bool__(self) -> bool:
        return self.status is Status.OK

    def swapped(self) -> FundamentalEstimate:
        """Return the same with the two images in the other order."""
        F, E = (None if M is None else np.ascontiguousarray(M.T) for M in (self.F, self.E))
        calibrated = None if self.calibrated is None else self.calibrated.swapped()
        H = self.H
        if H is not None:
            back: FloatArray = np.linalg.inv(H).astype(np.float64)
            H = back / np.linalg.norm(back)
        both = replace(self, x1=self.x2, x2=self.x1, roll_deg=0.0 - self.roll_deg)
        return replace(both, F=F, H=H, E=E, calibrated=calibrated)
