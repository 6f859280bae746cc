"""Which pairs of a collection are relied on: by their confidence, and by focal lengths that are known.

Where EXIF or the user tells both focal lengths, COLMAP estimates an essential matrix on the inliers of F. A right F
keeps nearly all of them. A wrong one, of structure that repeats, mostly asks for other focal lengths.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from epiprior.collection.store import MatchedPair
from epiprior.io.colmap import estimate_essential
from epiprior.types import FloatArray

# Of the inliers of F. On validation scenes no right F of 63 is below, and three wrong ones of four are.
MIN_CALIBRATED = 0.8
CONTRADICTS = "contradicts the focal lengths"


def under_cameras(
    pair: MatchedPair, cameras: tuple[Any, Any], keypoints: tuple[FloatArray, FloatArray], seed: int = 0
) -> MatchedPair:
    """Return a pair with what its cameras, of pycolmap, say: a share, and the essential matrix if that is high enough.

    `keypoints`, (N, 2), are those that the matches name. Only a general F is looked at. The matches of the result are
    inliers of the essential matrix where there is one.
    """
    if pair.geometry != "UNCALIBRATED":
        return pair
    own = len(pair.matches) - pair.guided
    x1, x2 = (xy[rows].astype(np.float64) for xy, rows in zip(keypoints, pair.matches.T, strict=True))
    found = estimate_essential(x1[:own], x2[:own], cameras, seed)
    share = 0.0 if found is None else float(found["num_inliers"] / own)
    if share >= MIN_CALIBRATED and pair.guided:
        found = estimate_essential(x1, x2, cameras, seed)
    if share < MIN_CALIBRATED or found is None:
        return replace(pair, calibrated=share)
    keep = found["inlier_mask"]
    known: dict[str, Any] = {"geometry": "CALIBRATED", "E": found["E"], "guided": int(keep[own:].sum())}
    return replace(pair, calibrated=share, matches=pair.matches[keep], **known)


def judge_pairs(
    matched: Iterable[MatchedPair], least: float, tell: Callable[[str], None] | None = None
) -> Iterator[tuple[MatchedPair, str]]:
    """Yield every pair and why it is not relied on; empty if it is.

    Pairs below the confidence `least` are not, nor those that contradict the focal lengths of their cameras: unless
    most do, in which case the focal lengths must be wrong. `matched` is read twice, and `tell` gets a line on this.
    """
    doubted = [p.calibrated < MIN_CALIBRATED for p in matched if _confident(p, least) and p.calibrated is not None]
    trusted = 2 * sum(doubted) <= len(doubted)
    if any(doubted) and tell:
        what = "were left out" if trusted else "were kept, since these must be wrong"
        tell(f"{sum(doubted)} of {len(doubted)} pairs contradict the focal lengths of their cameras, and {what}")
    for pair in matched:
        if not pair.geometry or not len(pair.matches):
            yield pair, pair.status
        elif not _confident(pair, least):
            yield pair, "low confidence"
        else:
            against = trusted and pair.calibrated is not None and pair.calibrated < MIN_CALIBRATED
            yield pair, CONTRADICTS if against else ""


def _confident(pair: MatchedPair, least: float) -> bool:
    return bool(pair.geometry) and pair.confidence >= least
