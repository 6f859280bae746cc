"""A look through the files of a COLMAP model, before pycolmap reads them.

pycolmap says little of damage, and reads a binary file of cameras that was cut off without a word.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_lines

# Values per line, at least: id, model, width, height, parameters; id, pose, camera, name; id, point, colour, error.
_TEXT_FORMS = {"cameras": (5, (0, 2, 3)), "images": (10, tuple(range(9))), "points3D": (8, tuple(range(8)))}


def check_model(folder: Path) -> None:
    """Walk through ``cameras``, ``images`` and ``points3D``, binary if they are there, else text.

    Raises
    ------
    DatasetError
        If a file ends too early or late, or a line of text has too few or wrong values; the message names the file,
        and the line of text.
    """
    if (folder / "cameras.bin").is_file():
        for name, walk in (("cameras", _cameras), ("images", _images), ("points3D", _points)):
            _check_binary(folder / f"{name}.bin", walk)
        return
    for name, (least, numeric) in _TEXT_FORMS.items():
        _check_text(folder / f"{name}.txt", least, numeric, every=2 if name == "images" else 1)


class _Walk:
    """A position in the bytes of a file."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(self, layout: str) -> tuple[int, ...]:
        """Return the next values; struct.error at the end of the file."""
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.skip(struct.calcsize("<" + layout))
        return values

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise struct.error


def _check_binary(path: Path, walk: Callable[[_Walk], None]) -> None:
    try:
        position = _Walk(path.read_bytes())
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    done = 0
    try:
        (count,) = position.take("Q")
        while done < count:
            walk(position)
            done += 1
    except (struct.error, ValueError) as error:
        what = f"what follows {done} entries"
        raise DatasetError(f"{path}: damaged: {what} is cut off or impossible") from error
    if position.at != len(position.data):
        raise DatasetError(f"{path}: damaged: {len(position.data) - position.at} bytes after the last entry")


def _cameras(walk: _Walk) -> None:
    import pycolmap

    _, model, _, _ = walk.take("IiQQ")
    count = len(pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(model), 1.0, 1, 1).params)
    walk.skip(8 * count)


def _images(walk: _Walk) -> None:
    walk.take("I7dI")
    end = walk.data.index(b"\0", walk.at)
    walk.skip(end + 1 - walk.at)
    (count,) = walk.take("Q")
    walk.skip(24 * count)


def _points(walk: _Walk) -> None:
    walk.take("Q3d3Bd")
    (count,) = walk.take("Q")
    walk.skip(8 * count)


def _check_text(path: Path, least: int, numeric: tuple[int, ...], every: int) -> None:
    # A photograph without points has an empty second line, so that lines are counted before empty ones are dropped.
    lines = [(number, text) for number, text in read_lines(path) if not text.startswith("#")]
    if every == 2:
        numbers = {number for number, _ in lines}
        first = min(numbers, default=0)
        lines = [(number, text) for number, text in lines if (number - first) % 2 == 0]
    for number, text in lines:
        values = text.split()
        if len(values) < least:
            raise DatasetError(f"{path}, line {number}: {len(values)} values, expected {least} or more")
        for index in numeric:
            try:
                float(values[index])
            except ValueError as error:
                raise DatasetError(f"{path}, line {number}: {values[index]!r} is no number") from error
