"""Pictures that show images: the contact sheet of rendered pairs, one rescued pair, densities of the roll."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from epiprior.draw.captions import Picture, draw_label
from epiprior.draw.pictures import DrawSettings, draw_matches
from epiprior.features.images import read_image
from epiprior.matching.baselines import standard_matches
from epiprior.matching.pair import orientation_differences, roll_density
from epiprior.rank import rank_matches
from epiprior.two_view import estimate_fundamental
from epiprior.types import FloatArray, FundamentalEstimate, MatchSet
from epiprior_lab.pairsets import DatasetError, Pair
from epiprior_lab.report.results import Results
from epiprior_lab.report.style import INK, MUTED, styled
from epiprior_lab.report.text import BASELINES, OURS
from epiprior_lab.scenes.world import Image

EXAMPLE_ESTIMATOR = "usac"
ROLL_PANELS = 6
_THUMBNAIL = (384, 288)
_GAP = 8
_PANEL_INCHES = (3.6, 1.78)
_ROLL = re.compile(r"roll=(-?\d+)deg")


def contact_sheet(pair_sets: Mapping[str, Sequence[Pair]], path: Path) -> Path:
    """Draw pairs by family in rows of a figure, with what makes them easy or hard below each, and return `path`.

    A DatasetError says that there is no pair to show, an ImageError that an image cannot be read.
    """
    columns = max((len(pairs) for pairs in pair_sets.values()), default=0)
    if not columns:
        raise DatasetError(f"{path}: no pairs for a contact sheet")
    across = min(columns, 4)
    rows_of = {family: -(-len(pairs) // across) for family, pairs in pair_sets.items()}
    rows = sum(rows_of.values())
    with styled(path, rows, across, (_PANEL_INCHES[0] * across, _PANEL_INCHES[1] * rows)) as (figure, axes):
        first = 0
        for family, pairs in pair_sets.items():
            cells = [cell for row in axes[first : first + rows_of[family]] for cell in row]
            for k, cell in enumerate(cells):
                cell.set_axis_off()
                if k < len(pairs):
                    left, right = _padded(_thumbnail(pairs[k].image1), (0, 0, 0, _GAP)), _thumbnail(pairs[k].image2)
                    cell.imshow(np.hstack([left, right]), interpolation="none")
                    cell.set_title(family if k == 0 else " ", fontsize=11, color=INK)
                    how: Any = {"ha": "center", "va": "top", "fontsize": 8, "color": MUTED}
                    cell.text(0.5, -0.03, _caption(pairs[k]), transform=cell.transAxes, **how)
            first += rows_of[family]
        engine = figure.get_layout_engine()
        if engine is not None:  # little room between panels
            engine.set(w_pad=0.04, h_pad=0.05, wspace=0.01, hspace=0.02)  # type: ignore[call-arg]
    return path


def _thumbnail(path: Path) -> Image:
    """Return an image at the size of the sheet, RGB, padded with white to its shape."""
    image = read_image(path, cv2.IMREAD_COLOR)
    width, height = _THUMBNAIL
    scale = min(width / image.shape[1], height / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:height, :width]
    high, wide = height - small.shape[0], width - small.shape[1]
    return _padded(cv2.cvtColor(small, cv2.COLOR_BGR2RGB), (high // 2, -(-high // 2), wide // 2, -(-wide // 2)))


def _padded(picture: np.ndarray[Any, Any], margins: tuple[int, int, int, int]) -> Image:
    """Return a picture with white on top, below, on the left and on the right, pixels."""
    return np.asarray(cv2.copyMakeBorder(picture, *margins, cv2.BORDER_CONSTANT, value=(255, 255, 255)), np.uint8)


def _caption(pair: Pair) -> str:
    """Return what makes a pair easy or hard, for a reader; a roll from -179 to 180 degrees."""
    turned = _ROLL.sub(lambda found: f"roll={(int(found[1]) + 179) % 360 - 179}deg", pair.difficulty)
    parts = [part.replace("=", " ").replace("deg", "°") for part in turned.split(";") if part]
    return "   ".join(parts) or pair.pair_id


def rescued_pair(results: Results, group: str) -> str:
    """Return the pair of a group that gained most: the largest difference of successes, then the smallest error."""
    before, after = (results.errors[EXAMPLE_ESTIMATOR, name] for name in (BASELINES[0], OURS))
    gain = (after < 10).mean(axis=1) - (before < 10).mean(axis=1)
    places = np.flatnonzero(results.masks[group])
    pair_ids = results.tables.pairs["pair_id"].to_numpy(str)
    order = np.lexsort((pair_ids[places], after.mean(axis=1)[places], -gain[places]))
    return str(pair_ids[places[order[0]]])


def example_picture(pair: Pair, path: Path) -> Path:
    """Draw the best matches and epipolar lines of a pair, the baseline on the left, ours on the right."""
    images = (pair.image1, pair.image2)
    before = estimate_fundamental(*images, estimator=EXAMPLE_ESTIMATOR, mode="standard")
    ranked = rank_matches(*images)
    after = estimate_fundamental(*images, estimator=EXAMPLE_ESTIMATOR, ranked=ranked)
    used = next((found for found in ranked.sets if found.roll_deg == after.roll_deg), ranked.sets[0])
    pictures = [_drawn(images, standard_matches(*images), before), _drawn(images, used, after)]
    height = max(len(picture) for picture in pictures)
    left, right = (_padded(p, (0, height - len(p), 0, gap)) for p, gap in zip(pictures, (12, 0), strict=True))
    picture = np.hstack([left, right])
    path.parent.mkdir(parents=True, exist_ok=True)
    _, encoded = cv2.imencode(".jpg", picture[:, :, ::-1].copy(), [cv2.IMWRITE_JPEG_QUALITY, 88])
    path.write_bytes(encoded.tobytes())
    return path


def _drawn(images: tuple[Path, Path], matches: MatchSet, estimate: FundamentalEstimate) -> Picture:
    """Return matches and epipolar lines, or a line that says why there are none."""
    picture = draw_matches(*images, matches, estimate, settings=DrawSettings(max_matches=60, max_panel_size=640))
    if estimate:
        return picture
    return np.vstack([picture, draw_label(picture.shape[1], f"no epipolar lines: {estimate.message}")])


def rolled_pairs(results: Results, panels: int = ROLL_PANELS) -> dict[tuple[str, str], float]:
    """Return some pairs and their true roll, degrees: from half a turn down to slight ones, by (group, pair id)."""
    pairs = results.tables.pairs.dropna(subset="true_roll_deg")
    turn = pairs["true_roll_deg"].abs().round(6).sort_values(ascending=False, kind="stable")
    step = max(1, len(turn[turn > 20]) // panels)
    chosen = pairs.loc[turn.index[: step * panels : step]]
    return {(str(row["group"]), str(row["pair_id"])): float(row["true_roll_deg"]) for row in chosen.to_dict("records")}


def density_of_roll(pair: Pair, step: int = 2) -> tuple[FloatArray, FloatArray]:
    """Return angles, degrees, and the density of the roll over X_L and X_B, 1/degree (paper, section 4.2)."""
    matches = rank_matches(pair.image1, pair.image2).sets[0]
    chosen = (matches.distance_ratio < 1) | (matches.similarity_weight > 0)
    angles, density = roll_density(orientation_differences(matches.orientation1_deg, matches.orientation2_deg)[chosen])
    return angles[::step], density[::step]
