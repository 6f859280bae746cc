"""One pair of a collection: a task that reads stored features and gives matches of keypoints with a geometry."""

import functools
import hashlib
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.spatial import cKDTree

from epiprior.collection.features import StoredFeatures, read_features
from epiprior.collection.images import CollectionImage
from epiprior.collection.store import MatchedPair
from epiprior.collection.workers import installation
from epiprior.estimators.essential import Intrinsics
from epiprior.estimators.handover import load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.images import blank_photograph
from epiprior.io.colmap import configuration_of, intrinsics_of
from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.matching.baselines import snn_of_largest
from epiprior.matching.guided import guided_matches
from epiprior.presets import Mode, PreprocessSettings, check_choice
from epiprior.two_view import estimate_fundamental
from epiprior.types import Features, FloatArray, FundamentalEstimate, IntArray
from epiprior.verification.cascade import load_cascade_rule

LARGEST = 2_000  # features that a cascade tries first
_SAME_PLACE_PX = 0.01
_COPY_SHARE = 0.2  # of the features; on validation scenes copies match at least 0.31, pictures under an overlay 0.09
_GUIDED_PX = 2.0  # working pixels
_read = functools.lru_cache(maxsize=8)(read_features)  # pairs come image by image


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """How each pair of a collection is matched; see `epiprior.estimate_fundamental`."""

    settings: PreprocessSettings
    mode: Mode = "cascade"
    estimator: str = "epiprior"
    seed: int = 0
    threshold_px: float | None = None

    def __post_init__(self) -> None:
        check_choice("mode", self.mode, get_args(Mode))

    def pair_key(self, feature_keys: tuple[str, str], cameras: tuple[Any, Any] | None) -> bytes:
        """Return what the matches of two images depend on."""
        known = [f"{c.model.name} {c.width} {c.height} {list(c.params)}" for c in cameras or ()]
        return hashlib.sha256("\0".join([*feature_keys, *known, repr(self), installation()]).encode()).digest()


def match_pair(
    images: tuple[CollectionImage, CollectionImage],
    files: tuple[Path, Path],
    how: MatchSettings,
    cameras: tuple[Any, Any] | None = None,
) -> tuple[MatchedPair, MatchedPair]:
    """Match two images whose features are in files: a task.

    Returns the pair without and under its `cameras`, of pycolmap, whose focal lengths are known; twice the same where
    they are not, or no essential matrix was found.
    """
    start = time.perf_counter()
    stored = _read(files[0]), _read(files[1])
    both = stored[0].features, stored[1].features
    known = None if cameras is None else (intrinsics_of(cameras[0]), intrinsics_of(cameras[1]))
    found = _of_largest(both, how, known) if how.mode == "cascade" else None
    compared = min(*map(len, both), *(() if found is None else (LARGEST,)))
    if found is None:
        view1, view2 = (one.view(image, how.settings.features) for one, image in zip(stored, images, strict=True))
        found = estimate_fundamental(view1, view2, features1=both[0], features2=both[1], intrinsics=known, **vars(how))
    plain = _gather(images, stored, found, how, start, compared)
    if known is None or found.calibrated is None:
        return plain, plain
    return plain, _gather(images, stored, found.calibrated, how, start, compared, known)


def _of_largest(
    features: tuple[Features, Features], how: MatchSettings, intrinsics: tuple[Intrinsics, Intrinsics] | None
) -> FundamentalEstimate | None:
    """Estimate F on simple matches of the largest features; None unless the rule of the cascade keeps it.

    Under known intrinsics the estimate under these has to be kept as well.
    """
    if max(map(len, features)) <= LARGEST:
        return None
    matches = snn_of_largest(*features, largest=LARGEST, features=how.settings.features)
    chosen = load_hand_overs()[how.estimator]["snn"]
    found = estimate_from_matches(
        [matches],
        estimator=how.estimator,
        seed=how.seed,
        hand_over=chosen if how.threshold_px is None else replace(chosen, threshold_px=how.threshold_px),
        pixel_factors=_factors(features, how.settings),
        intrinsics=intrinsics,
    )
    calibrated, rule = found.calibrated, load_cascade_rule()
    if not found or not all(rule.keeps(one) for one in (found, calibrated) if one is not None):
        return None
    return replace(found, input="snn", calibrated=None if calibrated is None else replace(calibrated, input="snn"))


def _factors(features: tuple[Features, Features], settings: PreprocessSettings) -> tuple[float, float]:
    """Return given pixels per working pixel."""
    limit = settings.features.max_image_size
    return blank_photograph(features[0].image_size, limit).factor, blank_photograph(
        features[1].image_size, limit
    ).factor


def _gather(
    images: tuple[CollectionImage, CollectionImage],
    stored: tuple[StoredFeatures, StoredFeatures],
    found: FundamentalEstimate,
    how: MatchSettings,
    start: float,
    compared: int,
    intrinsics: tuple[Intrinsics, Intrinsics] | None = None,
) -> MatchedPair:
    """Return a pair; an F that comes from simple matches gets those along its lines, which ranked ones have.

    Two pictures of one view, such as frames of a camera that stands still, share most of their `compared` features, and
    are to COLMAP what a camera that turns sees. Where only a few do not move, something lies over both pictures.
    """
    first, second = stored[0].features, stored[1].features
    geometry = configuration_of(found)
    inliers = np.flatnonzero(found.inliers) if geometry else np.empty(0, np.int64)
    rows = np.column_stack([_rows_of(stored[0], found.x1[inliers]), _rows_of(stored[1], found.x2[inliers])])
    rows = rows[one_to_one_mask(*rows.T)]
    own = len(rows)
    if geometry == "WATERMARK" and own >= _COPY_SHARE * compared:
        geometry = "PANORAMIC"
    if found and found.F is not None and found.input != how.settings.name:
        camera1, camera2 = intrinsics or (None, None)
        straight = _undistorted(first, camera1), _undistorted(second, camera2)
        more = guided_matches(
            *straight, found.F, threshold_px=_GUIDED_PX, factors=_factors((first, second), how.settings)
        )
        rows = np.concatenate(
            [rows, np.column_stack([one.first_rows[side] for one, side in zip(stored, more.T, strict=True)])]
        )
        rows = rows[one_to_one_mask(*rows.T)]
    return MatchedPair(
        image1=images[0].name,
        image2=images[1].name,
        status=found.status.value,
        message=found.message,
        geometry=geometry,
        confidence=found.confidence if found else float(bool(geometry)),
        F=found.F if found else None,
        H=found.H,
        E=found.E,
        matches=rows,
        guided=len(rows) - own,
        input=found.input,
        seconds=time.perf_counter() - start,
    )


def _undistorted(features: Features, camera: Intrinsics | None) -> Features:
    if camera is None or camera.undistort is None:
        return features
    return replace(features, xy=camera.undistort(features.xy.astype(np.float64)).astype(np.float32))


def _rows_of(stored: StoredFeatures, xy: FloatArray) -> IntArray:
    """Return the first feature at each place, (N, 2), where there is one."""
    if not len(xy):
        return np.empty(0, np.int64)
    distance, row = cKDTree(stored.features.xy).query(xy)
    assert distance.max() < _SAME_PLACE_PX
    return np.asarray(stored.first_rows[row], dtype=np.int64)
