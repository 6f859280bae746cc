"""Which pairs of a collection are relied on: by their confidence, and by focal lengths that are known.

Where EXIF or the user tells both focal lengths, COLMAP estimates an essential matrix on the inliers of F. A right F
keeps nearly all of them; a wrong one, of structure that repeats, often asks for other focal lengths.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from epiprior.collection.store import MatchedPair
from epiprior.features.images import blank_photograph
from epiprior.io.colmap import estimate_essential
from epiprior.types import FloatArray

if TYPE_CHECKING:
    from epiprior.collection.run import MatchedCollection

# Of the inliers of F: the highest step of benchmarks/relied_on.py, on validation scenes, that no right F falls below.
# These have exact intrinsics, and few wrong F.
MIN_CALIBRATED = 0.75
CONTRADICTS = "contradicts the focal lengths"


def under_cameras(
    pair: MatchedPair,
    cameras: tuple[Any, Any],
    keypoints: tuple[FloatArray, FloatArray],
    *,
    max_image_size: int,
    seed: int = 0,
) -> MatchedPair:
    """Return a pair with what its cameras, of pycolmap, say: a share, and the essential matrix if that is high enough.

    `keypoints`, (N, 2), are those that the matches name. Only a general F is looked at. The matches of the result are
    inliers of the essential matrix where there is one. COLMAP's threshold is meant in working pixels, as that of F is:
    images larger than `max_image_size` count as if they had that size.
    """
    if pair.geometry != "UNCALIBRATED":
        return pair
    own = len(pair.matches) - pair.guided
    x1, x2 = (xy[rows].astype(np.float64) for xy, rows in zip(keypoints, pair.matches.T, strict=True))
    factor = np.mean([blank_photograph((camera.width, camera.height), max_image_size).factor for camera in cameras])
    how: dict[str, Any] = {"factor": float(factor), "seed": seed}
    found = estimate_essential(x1[:own], x2[:own], cameras, **how)
    share = 0.0 if found is None else float(found["num_inliers"] / own)
    if share >= MIN_CALIBRATED and pair.guided:
        found = estimate_essential(x1, x2, cameras, **how)
    if share < MIN_CALIBRATED or found is None:
        return replace(pair, calibrated=share)
    keep = found["inlier_mask"]
    known: dict[str, Any] = {"geometry": "CALIBRATED", "E": found["E"], "guided": int(keep[own:].sum())}
    return replace(pair, calibrated=share, matches=pair.matches[keep], **known)


def judge_pairs(
    matched: "MatchedCollection", least: float, tell: Callable[[str], None] | None = None
) -> Iterator[tuple[MatchedPair, str]]:
    """Yield every pair and why it is not relied on; empty if it is.

    Pairs below the confidence `least` are not, nor those that contradict the focal lengths of their cameras: unless
    most do, in which case the focal lengths are wrong, and all pairs are as without. `tell` gets a line on this. The
    collection is read twice.
    """
    against = [_contradicts(pair) for pair in matched if _confident(pair, least) and pair.calibrated is not None]
    trusted = 2 * sum(against) <= len(against)
    if any(against) and tell:
        what = "left out" if trusted else "these must be wrong, and are not used"
        tell(f"{sum(against)} of {len(against)} pairs contradict the focal lengths of their cameras: {what}")
    for pair in matched if trusted else matched.plain:
        if not pair.geometry or not len(pair.matches):
            yield pair, pair.status
        elif not _confident(pair, least):
            yield pair, "low confidence"
        else:
            yield pair, CONTRADICTS if _contradicts(pair) else ""


def _confident(pair: MatchedPair, least: float) -> bool:
    return bool(pair.geometry) and pair.confidence >= least


def _contradicts(pair: MatchedPair) -> bool:
    return pair.calibrated is not None and pair.calibrated < MIN_CALIBRATED
