"""COLMAP models: undistorted photographs with cameras, pairs by viewing angle, control points from tracks."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import number, read_text
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of
from epiprior_lab.pairsets.importers.structure import PairChoice, pairs_of_models

_NAMES = ("cameras", "images", "points3D")


def find_colmap(
    folder: Path, *, images: Path | None = None, scene: str | None = None, choice: PairChoice | None = None
) -> list[FoundPair]:
    """Return pairs of a COLMAP model.

    Parameters
    ----------
    folder : Path
        A model (``cameras``, ``images`` and ``points3D`` as ``.bin`` or ``.txt``), or a workspace with models in
        ``sparse/0``, ``sparse/1``, ... or ``sparse``, each of which is a scene.
    images : Path, optional
        Folder of the photographs; ``images`` in `folder` or in one of the two folders above by default.
    scene : str, optional
        Name of the scene; the workspace's by default.
    choice : PairChoice, optional
        Which pairs.

    Raises
    ------
    DatasetError
        If there is no model, it is damaged, a photograph is missing, or no pair is as `choice` asks; the message names
        the file.
    """
    choice = choice or PairChoice()
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    models = _models(folder)
    images = images or _images_near(folder)
    if not images.is_dir():
        raise DatasetError(f"{images}: no such folder")
    pairs, _ = pairs_of_models(
        [_read(model) for model in models],
        lambda name: Photograph(name=name_of(name), path=images / name),
        scene or images.resolve().parent.name,
        choice,
    )
    if not pairs:
        raise DatasetError(f"{folder}: no pair with {choice}")
    return pairs


def _models(folder: Path) -> list[Path]:
    """Return the folders of the models of a workspace; DatasetError if there is none."""
    for candidates in ([folder], sorted(folder.glob("sparse/*")), [folder / "sparse"]):
        models = [
            path
            for path in candidates
            if any(all((path / f"{name}{suffix}").is_file() for name in _NAMES) for suffix in (".bin", ".txt"))
        ]
        if models:
            return models
    raise DatasetError(f"{folder}: no COLMAP model: neither here nor in sparse are {', '.join(_NAMES)} (.bin or .txt)")


def _images_near(folder: Path) -> Path:
    resolved = folder.resolve()
    tried = [path / "images" for path in (resolved, *list(resolved.parents)[:2])]
    for path in tried:
        if path.is_dir():
            return path
    raise DatasetError(f"{folder}: no folder of images; tried {', '.join(map(str, tried))}; name it with --images")


def _read(model: Path) -> Any:
    """Return the reconstruction of a model."""
    import pycolmap

    _check_model(model)
    try:
        reconstruction = pycolmap.Reconstruction(model)
    except (ValueError, IndexError, MemoryError, RuntimeError) as error:
        raise DatasetError(f"{model}: damaged COLMAP model: {error}") from error
    for camera in reconstruction.cameras.values():
        if camera.width <= 0 or camera.height <= 0 or not np.isfinite(camera.params).all():
            raise DatasetError(f"{model}: camera {camera.camera_id} has an impossible size or parameters")
    return reconstruction


# --- the files of a model


def _check_model(folder: Path) -> None:
    """Walk through ``cameras``, ``images`` and ``points3D``, binary if they are there, else text.

    pycolmap says little of damage, and reads a binary file of cameras that was cut off without an error.

    Raises
    ------
    DatasetError
        If a file ends too early or late, a line of text has too few or wrong values, or the name of an image is one
        that COLMAP's text files or pycolmap cannot hold; the message names the file, and the line of text.
    """
    if (folder / "cameras.bin").is_file():
        for name, walk in zip(_NAMES, (_cameras, _images, _points), strict=True):
            _check_binary(folder / f"{name}.bin", walk)
        return
    # Values per line, at least: id, model, width, height, parameters; id, pose, camera, name; id, point, colour, error.
    for name, least, numeric in (("cameras", 5, (0, 2, 3)), ("images", 10, range(9)), ("points3D", 8, range(8))):
        _check_text(folder / f"{name}.txt", least, numeric, images=name == "images")


class _Walk:
    """A position in the bytes of a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Return the next values; struct.error at the end of the file."""
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.skip(struct.calcsize("<" + layout))
        return values

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise struct.error


def _check_binary(path: Path, walk: Callable[[_Walk], None]) -> None:
    done = 0
    try:
        position = _Walk(path)
        (count,) = position.take("Q")
        while done < count:
            walk(position)
            done += 1
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    except DatasetError:
        raise
    except (struct.error, ValueError) as error:
        raise DatasetError(f"{path}: damaged: what follows {done} entries is cut off or impossible") from error
    if position.at != len(position.data):
        raise DatasetError(f"{path}: damaged: {len(position.data) - position.at} bytes after the last entry")


def _cameras(walk: _Walk) -> None:
    import pycolmap

    _, model, _, _ = walk.take("IiQQ")
    count = len(pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId(model), 1.0, 1, 1).params)
    walk.skip(8 * count)


def _images(walk: _Walk) -> None:
    walk.take("I7dI")
    name = walk.data[walk.at : walk.data.index(b"\0", walk.at)]
    try:
        name.decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{walk.path}: the name {name!r} of an image is not UTF-8, as pycolmap needs it") from error
    walk.skip(len(name) + 1)
    (count,) = walk.take("Q")
    walk.skip(24 * count)


def _points(walk: _Walk) -> None:
    walk.take("Q3d3Bd")
    (count,) = walk.take("Q")
    walk.skip(8 * count)


def _check_text(path: Path, least: int, numeric: tuple[int, ...] | range, *, images: bool) -> None:
    rows = [(line, text) for line, text in enumerate(read_text(path).splitlines(), 1) if not text.startswith("#")]
    if images:
        # Two lines per photograph, the second without points is empty; blank lines before the first do not count.
        first = next((index for index, (_, text) in enumerate(rows) if text.strip()), 0)
        rows = rows[first::2]
    for line, text in rows:
        values = text.split()
        if not values:
            continue
        if len(values) < least:
            raise DatasetError(f"{path}, line {line}: {len(values)} values, expected {least} or more")
        if images and len(values) > least:
            name = text.split(maxsplit=least - 1)[-1].strip()
            raise DatasetError(
                f"{path}, line {line}: COLMAP's text format holds no name with a blank, such as {name!r}; give the "
                "model as .bin"
            )
        for index in numeric:
            try:
                number(values[index])
            except ValueError as error:
                raise DatasetError(f"{path}, line {line}: {values[index]!r} is no number") from error
