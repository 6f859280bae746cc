"""One page on a collection: what was registered, which pairs have a geometry, cameras and points, what was left out."""

import base64
from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from string import Template

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.collection.model import Model
from epiprior.collection.run import MatchedCollection
from epiprior.collection.verify import CONTRADICTS, CONTRADICTS_OTHERS, JudgedPairs
from epiprior.io.output import replacing
from epiprior.types import FloatArray

Picture = NDArray[np.uint8]
_SIDE = 480
_MOST_DRAWN = 50_000
_CAMERA = (40, 40, 220)  # BGR
_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>epiprior: $title</title><style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
table { border-collapse: collapse } th, td { padding: .15rem .8rem .15rem 0; text-align: left; vertical-align: top }
th { border-bottom: 1px solid #888 } td.n, th.n { text-align: right } .no { color: #b00020 }
img { border: 1px solid #ddd; margin-right: .5rem } .matrix { image-rendering: pixelated; width: ${side}px }
</style></head><body>
<h1>$title</h1>
<p>$summary</p>
<h2>Cameras and points</h2>
$views
<h2>Images</h2>
$images
<h2>Pairs</h2>
<p>Rows and columns are the images in the order of the table. Upper right: how confident the geometry of a pair is, from
grey (0) to green (1); white: not matched. Lower left: how many inliers it has, from grey (none) to blue (1,000 or
more).</p>
<p><img class="matrix" src="$matrix" alt="Matrix of pairs"></p>
$outcomes
<h2>Tracks</h2>
$tracks
<h2>Left out</h2>
$left_out
</body></html>
""")


def write_report(path: Path, judged: JudgedPairs, models: Sequence[Model]) -> None:
    """Write the page: a file without links to others."""
    matched = judged.matched
    names = [image.name for image in matched.images.images]
    place = {name: index for index, name in enumerate(names)}
    confidence, inliers = np.full((len(names), len(names)), np.nan), np.zeros((len(names), len(names)))
    outcomes: Counter[str] = Counter()
    against: Counter[tuple[str, str]] = Counter()
    for pair, why_not in judged:
        at = place[pair.image1], place[pair.image2]
        confidence[at], inliers[at] = pair.confidence, 0 if why_not else len(pair.matches)
        outcomes[f"not written: {why_not}" if why_not else pair.geometry] += 1
        against.update((name, why_not) for name in (pair.image1, pair.image2))
    registered = {name: (number, seen) for number, model in enumerate(models) for name, seen in model.seen.items()}
    summary = f"{len(registered)} of {len(names)} images are registered, in {len(models)} models. "
    summary += f"{int((inliers > 0).sum())} of {len(matched)} pairs have a geometry. " + ". ".join(judged.remarks)
    text = _PAGE.substitute(
        title=escape(matched.images.root.name),
        side=_SIDE,
        summary=summary,
        views="".join(_views(number, model) for number, model in enumerate(models)) or "<p>There is no model.</p>",
        images=_table(
            ("image", "features", "pairs", "model", "points"), _image_rows(matched, inliers, against, registered), 1
        ),
        matrix=_inline(_matrix(confidence, inliers)),
        outcomes=_table(("pairs", "how many"), ((kind, str(count)) for kind, count in outcomes.most_common()), 1),
        tracks="".join(_tracks(number, model) for number, model in enumerate(models)) or "<p>None.</p>",
        left_out=_table(("file", "why"), matched.images.left_out, 2) if matched.images.left_out else "<p>Nothing.</p>",
    )
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def _image_rows(
    matched: MatchedCollection,
    inliers: FloatArray,
    against: Counter[tuple[str, str]],
    registered: dict[str, tuple[int, int]],
) -> Iterable[tuple[str, ...]]:
    """Yield a row per image; where it is not registered, the reason."""
    both = inliers + inliers.T
    for index, image in enumerate(matched.images.images):
        count = int((both[index] > 0).sum())
        number, seen = registered.get(image.name, (None, 0))
        why = f"the mapper did not place it, best pair {both[index].max():.0f}" if count else "no pair has a geometry"
        for reason in (CONTRADICTS, CONTRADICTS_OTHERS):
            times = against[image.name, reason]
            why += f", {times} {reason.replace('contradicts', 'contradict')}" if times else ""
        model = f"no: {why}" if number is None else str(number)
        yield image.name, str(len(matched.features(index))), str(count), model, str(seen) if seen else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], text_columns: int) -> str:
    """Return a table whose first columns are text, the others numbers."""

    def cells(kind: str, row: Sequence[str]) -> str:
        classes = ["" if k < text_columns else "n" for k in range(len(row))]
        classes = ["no" if cell.startswith("no: ") else known for cell, known in zip(row, classes, strict=True)]
        return "".join(f'<{kind} class="{c}">{escape(cell)}</{kind}>' for cell, c in zip(row, classes, strict=True))

    body = "".join(f"<tr>{cells('td', row)}</tr>\n" for row in rows)
    return f"<table><tr>{cells('th', header)}</tr>\n{body}</table>"


def _matrix(confidence: FloatArray, inliers: FloatArray) -> Picture:
    picture = np.full((*confidence.shape, 3), 255, np.uint8)
    known = ~np.isnan(confidence)
    grey = np.array([225.0, 225.0, 225.0])
    for at, share, colour in (
        (known, np.nan_to_num(confidence), (70, 140, 30)),
        (known.T, np.log1p(np.minimum(inliers.T, 1000)) / np.log1p(1000), (170, 90, 20)),
    ):
        shaded = grey + share[..., None] * (np.array(colour) - grey)
        picture[at] = shaded[at].astype(np.uint8)
    return picture


def _views(number: int, model: Model) -> str:
    up = -model.rotations[:, 1].mean(axis=0)
    ahead = model.rotations[:, 2].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    right = np.cross(ahead, up)
    right /= max(float(np.linalg.norm(right)), 1e-9)
    ahead = np.cross(up, right)
    pictures = (("from above", _drawn(model, right, ahead)), ("from where the cameras are", _drawn(model, right, up)))
    images = "".join(f'<img src="{_inline(drawn)}" alt="Model {number} {how}">' for how, drawn in pictures)
    facts = f"{len(model.seen)} images, {len(model.points)} points, mean reprojection error {model.error_px:.2f} px"
    return f"<p>Model {number}: {facts}. Left from above, right as the cameras look. Red: cameras.</p><p>{images}</p>"


def _drawn(model: Model, across: FloatArray, upward: FloatArray) -> Picture:
    """Return a picture of the model along two axes of the world."""
    axes = np.column_stack([across, -upward])
    points, centres, views = model.points @ axes, model.centres @ axes, model.rotations[:, 2] @ axes
    # A few points far away would make all else small.
    low, high = np.percentile(points, (2, 98), axis=0) if len(points) else (centres.min(axis=0), centres.max(axis=0))
    low, high = np.minimum(low, centres.min(axis=0)), np.maximum(high, centres.max(axis=0))
    scale = 0.9 * _SIDE / max(float((high - low).max()), 1e-9)
    middle = (low + high) / 2
    picture = np.full((_SIDE, _SIDE, 3), 255, np.uint8)
    step = max(1, len(points) // _MOST_DRAWN)
    at = np.rint((points[::step] - middle) * scale + _SIDE / 2).astype(np.int64)
    inside = ((at >= 0) & (at < _SIDE)).all(axis=1)
    picture[at[inside, 1], at[inside, 0]] = model.colours[::step][inside][:, ::-1]
    for centre, view in zip((centres - middle) * scale + _SIDE / 2, views * 0.05 * _SIDE, strict=True):
        start, end = (tuple(np.rint(place).astype(int).tolist()) for place in (centre, centre + view))
        cv2.circle(picture, start, 3, _CAMERA, -1, cv2.LINE_AA)
        cv2.line(picture, start, end, _CAMERA, 1, cv2.LINE_AA)
    return picture


def _tracks(number: int, model: Model) -> str:
    rows = ((f"{length} images", str(count)) for length, count in sorted(model.tracks.items()))
    table = _table(("seen by", "points"), rows, 1)
    return f"<p>Model {number}: how many points are seen by how many images.</p>{table}"


def _inline(picture: Picture) -> str:
    encoded = cv2.imencode(".png", picture)[1].tobytes()
    return f"data:image/png;base64,{base64.b64encode(encoded).decode()}"
