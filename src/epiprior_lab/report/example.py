"""A picture of one rescued pair: where the baseline failed in every run, before and after preprocessing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from epiprior.draw.captions import Picture, draw_label
from epiprior.draw.pictures import DrawSettings, draw_matches
from epiprior.matching.baselines import standard_matches
from epiprior.rank import rank_matches
from epiprior.two_view import estimate_fundamental
from epiprior.types import FundamentalEstimate, MatchSet
from epiprior_lab.pairsets import Pair
from epiprior_lab.report.study import Study, errors_of

ESTIMATOR = "usac"
PANEL_SIZE = 640


def rescued_pair(study: Study, pairs: Sequence[Pair], family: str) -> Pair:
    """Return the pair of a family that gained most: the largest difference of successes, then the smallest error."""
    by_input = {
        name: errors_of(study.results, family=family, estimator=ESTIMATOR, input=name)
        for name in ("standard", "default")
    }
    gain = (by_input["default"] < 10).mean(axis=1) - (by_input["standard"] < 10).mean(axis=1)
    error = by_input["default"].mean(axis=1)
    order = np.lexsort((error.to_numpy(), -gain.to_numpy()))
    chosen = gain.index.get_level_values("pair_id")[order[0]]
    return next(pair for pair in pairs if pair.pair_id == chosen)


def example_figure(pair: Pair, path: Path) -> Path:
    """Draw the best matches and epipolar lines of a pair, the baseline on the left, ours on the right."""
    settings = DrawSettings(max_matches=60, max_panel_size=PANEL_SIZE)
    images = (pair.image1, pair.image2)
    before = estimate_fundamental(*images, estimator=ESTIMATOR, mode="standard")
    ranked = rank_matches(*images)
    after = estimate_fundamental(*images, estimator=ESTIMATOR, ranked=ranked)
    used = next((found for found in ranked.sets if found.roll_deg == after.roll_deg), ranked.sets[0])
    pictures = [
        _drawn(images, standard_matches(*images), before, settings),
        _drawn(images, used, after, settings),
    ]
    height = max(len(picture) for picture in pictures)
    padded = [
        cv2.copyMakeBorder(p, 0, height - len(p), 0, 0, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for p in pictures
    ]
    gap = np.full((height, 12, 3), 255, np.uint8)
    picture = np.hstack([padded[0], gap, padded[1]])
    path.parent.mkdir(parents=True, exist_ok=True)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 88]
    _, encoded = cv2.imencode(".jpg", np.ascontiguousarray(picture[:, :, ::-1]), quality)
    path.write_bytes(encoded.tobytes())
    return path


def _drawn(
    images: tuple[Path, Path], matches: MatchSet, estimate: FundamentalEstimate, settings: DrawSettings
) -> Picture:
    """Return matches and epipolar lines, or a line that says why there are none."""
    picture = draw_matches(*images, matches, estimate, settings=settings)
    if estimate.F is not None:
        return picture
    return np.vstack([picture, draw_label(picture.shape[1], f"no epipolar lines: {estimate.message}")])
