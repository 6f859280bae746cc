"""One pair of images, its file of control points, and what may be written into it."""

from __future__ import annotations

import hashlib
import json
import math
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from epiprior.errors import EpipriorError, ImageError
from epiprior.features.images import read_image
from epiprior.io.output import check_output, replacing
from epiprior.types import FloatArray
from epiprior_lab.labels.by_hand.fit import MIN_JUDGED, fit_pairs
from epiprior_lab.pairsets import DatasetError, write_control_points
from epiprior_lab.pairsets.files import read_control_points

MOST_PAIRS = 5_000
_CLICK_PER_SIDE = 1e-3  # a hand is right within a pixel of a photograph of 1,000


class LabelError(EpipriorError, ValueError):
    """Points cannot be taken, or a file is not this pair's; the message names the culprit."""


class ConflictError(LabelError):
    """The file was changed by somebody else since it was read."""


class LabelImage:
    """An image as OpenCV decodes it, turned as its EXIF data say; ImageError if it cannot be read.

    The page shows `png`, the decoded pixels, whatever the format: what features are found on. `sha256` is of the file.
    """

    def __init__(self, path: Path) -> None:
        pixels = read_image(path, cv2.IMREAD_COLOR)
        self.path, (self.height, self.width) = path, pixels.shape[:2]
        self.png: bytes = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        self.sha256 = hashlib.sha256(path.read_bytes()).hexdigest()

    def described(self) -> dict[str, Any]:
        """Return name and size."""
        return {"name": self.path.name, "width": self.width, "height": self.height}


class LabelSession:
    """Two images and the control points clicked in them, in the file `out`, which is continued where it exists.

    Beside ``points.csv`` is its record, ``points.pair.json``: names, sizes and hashes of the images of the points.
    ImageError if an image cannot be read or both are the same, OutputError if `out` can never be written. LabelError or
    DatasetError if `out` belongs to another pair or is damaged, unless `force` starts it anew.
    """

    def __init__(self, image1: Path, image2: Path, out: Path, *, force: bool = False) -> None:
        self.images = (LabelImage(image1), LabelImage(image2))
        if self.images[0].sha256 == self.images[1].sha256:
            raise ImageError(f"{image2}: the same image as {image1}; a pair has two views")
        self.out = out
        self._target = out.resolve()  # through a link: its end is replaced, not the link
        check_output(self._target, (".csv",))
        self._lock = threading.Lock()
        self._anew = False
        try:
            self._check_owner()
            self._read()
        except (LabelError, DatasetError):
            if not force:
                raise
            self._anew = True

    @property
    def click_px(self) -> float:
        """How precisely a hand clicks in images of this size, pixels."""
        longest = max(float(side) for image in self.images for side in (image.width, image.height))
        return max(1.0, _CLICK_PER_SIDE * longest)

    def count(self) -> int | None:
        """Return how many points this session's file holds; None where nothing was saved."""
        if self._anew or not self._target.exists():
            return None
        return len(self._read())

    def state(self) -> dict[str, Any]:
        """Return all that the page needs; DatasetError or LabelError if the file was damaged or exchanged since."""
        with self._lock:
            state = {"images": [image.described() for image in self.images], "file": self.out.name}
            points = [] if self._anew else self._read().tolist()
            return state | {"points": points, "revision": self._revision(), "judged_from": MIN_JUDGED}

    def fit(self, points: Any) -> dict[str, Any]:
        """Return what `fit_pairs` finds on points as the page sends them, as values of JSON."""
        x = self.checked(points)
        found = fit_pairs(x[:, :2], x[:, 2:], click_px=self.click_px)
        if found is None:
            return {"F": None}
        residuals = np.where(np.isfinite(found.residuals), found.residuals, 1e6)  # JSON knows no infinity
        arrays = {"F": found.F, "residuals": residuals, "far_off": found.far_off}
        return {name: array.tolist() for name, array in arrays.items()} | {"one_plane": found.one_plane}

    def save(self, points: Any, revision: Any) -> str:
        """Write points and the record, whole or not at all, and return the file's new revision.

        LabelError if they are no points, ConflictError if the file is no longer of the `revision` that they continue,
        OutputError if a file cannot be written.
        """
        x = self.checked(points)
        with self._lock:
            if revision != self._revision():
                raise ConflictError(f"{self.out.name} was changed by somebody else since it was read")
            # Points first: a run that is killed in between leaves no record that names this pair beside other points.
            with replacing(self._target) as partial:
                write_control_points(partial, np.ascontiguousarray(x[:, :2]), np.ascontiguousarray(x[:, 2:]))
            self._anew = False
            described = [image.described() | {"sha256": image.sha256} for image in self.images]
            record = {"image1": described[0], "image2": described[1]}
            with replacing(self._record) as partial:
                partial.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
            return self._revision()

    def checked(self, points: Any) -> FloatArray:
        """Return points [x1, y1, x2, y2] of the page as an array (N, 4).

        LabelError if they are no list of four finite numbers each, too many, or outside their image.
        """
        if not isinstance(points, list) or len(points) > MOST_PAIRS:
            raise LabelError(f"points: expected a list of at most {MOST_PAIRS} pairs")
        for number, point in enumerate(points, start=1):
            if not (isinstance(point, list) and len(point) == 4 and all(_is_finite(value) for value in point)):
                raise LabelError(f"pair {number}: expected four finite numbers x1, y1, x2, y2")
        x = np.array(points, dtype=np.float64).reshape(-1, 4)
        self._check_inside(x, "pair")
        return x

    @property
    def _record(self) -> Path:
        return self._target.with_suffix(".pair.json")

    def _revision(self) -> str:
        return hashlib.sha256(self._target.read_bytes()).hexdigest() if self._target.exists() else ""

    def _read(self) -> FloatArray:
        """Return the points of the file, shape (N, 4); none where there is no file."""
        if not self._target.exists():
            return np.empty((0, 4))
        x = np.column_stack(read_control_points(self._target))
        self._check_inside(x, f"{self.out}, point")
        return x

    def _check_inside(self, x: FloatArray, what: str) -> None:
        """Raise LabelError where a point lies outside its image: the area of its pixels, centres at whole numbers."""
        for side, image in enumerate(self.images):
            own = x[:, 2 * side : 2 * side + 2]
            outside = (own < -0.5) | (own > np.array([image.width, image.height]) - 0.5)
            if outside.any():
                row = int(np.flatnonzero(outside.any(axis=1))[0])
                raise LabelError(
                    f"{what} {row + 1}: ({own[row, 0]:g}, {own[row, 1]:g}) lies outside image {side + 1}, "
                    f"{image.path.name}, {image.width} x {image.height}"
                )

    def _check_owner(self) -> None:
        """Raise LabelError where the record of the file names other images."""
        hint = "; --force starts it anew"
        if not self._target.exists() or not self._record.exists():
            return
        try:
            record = json.loads(self._record.read_text(encoding="utf-8"))
            images = [record["image1"], record["image2"]]
            hashes, names = [image["sha256"] for image in images], [str(image["name"]) for image in images]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise LabelError(f"{self._record}: cannot be read as the record of {self.out.name}{hint}") from error
        expected = [image.sha256 for image in self.images]
        if hashes == expected[::-1]:
            raise LabelError(f"{self.out}: belongs to these images the other way round: {names[0]}, then {names[1]}")
        if hashes != expected:
            raise LabelError(f"{self.out}: belongs to another pair, {names[0]} and {names[1]}{hint}")


def _is_finite(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False
