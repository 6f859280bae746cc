"""COLMAP models: undistorted photographs with cameras, pairs by viewing angle, control points from tracks."""

import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import number, read_text
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of
from epiprior_lab.pairsets.importers.sources import need_folder
from epiprior_lab.pairsets.importers.structure import PairChoice, pairs_of_models

_NAMES = ("cameras", "images", "points3D")


def find_colmap(
    folder: Path, *, images: Path | None = None, scene: str | None = None, choice: PairChoice | None = None
) -> list[FoundPair]:
    """Return pairs of a COLMAP model, or of each model of a workspace, a scene of its own.

    `folder` holds a model (``cameras``, ``images`` and ``points3D`` as ``.bin`` or ``.txt``), or models in ``sparse``
    or ``sparse/0``, ``sparse/1``, ...; `images` is by default ``images`` in it or in one of the two folders above;
    `scene` is by default the workspace's name. DatasetError for no pair, a missing model or photograph, or a bad file.
    """
    choice = choice or PairChoice()
    models = _models(need_folder(folder))
    images = need_folder(images or _images_near(folder))
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
    forms = [[f"{name}{suffix}" for name in _NAMES] for suffix in (".bin", ".txt")]
    for candidates in ([folder], sorted(folder.glob("sparse/*")), [folder / "sparse"]):
        models = [one for one in candidates if any(all((one / name).is_file() for name in form) for form in forms)]
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


def _check_model(folder: Path) -> None:
    """Walk through the files of a model, binary if they are there, else text.

    pycolmap ends the process on a file that is cut off, or reads it without an error. DatasetError if a file ends too
    early or late, a line of text has too few or wrong values, or COLMAP cannot hold the name of an image.
    """
    if (folder / "cameras.bin").is_file():
        for name, after in zip(_NAMES, (_after_camera, _after_image, _after_point), strict=True):
            _check_binary(folder / f"{name}.bin", after)
        return
    # Values per line, at least: id, model, width, height, parameters; id, pose, camera, name; id, point, colour, error.
    for name, least, numeric in (("cameras", 5, (0, 2, 3)), ("images", 10, range(9)), ("points3D", 8, range(8))):
        _check_text(folder / f"{name}.txt", least, numeric, images=name == "images")


def _check_binary(path: Path, after: Callable[[bytes, int], int]) -> None:
    done = 0
    try:
        data = path.read_bytes()
        (count,), at = struct.unpack_from("<Q", data), 8
        while done < count:
            at = after(data, at)
            if at > len(data):
                raise struct.error
            done += 1
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: image {done + 1}: pycolmap reads no name that is not UTF-8: {error}") from error
    except (struct.error, ValueError) as error:
        raise DatasetError(f"{path}: damaged: what follows {done} entries is cut off or impossible") from error
    if at != len(data):
        raise DatasetError(f"{path}: damaged: {len(data) - at} bytes after the last entry")


def _after_camera(data: bytes, at: int) -> int:
    """Return where the entry ends: id, model, width, height, parameters."""
    import pycolmap

    model = pycolmap.CameraModelId(*struct.unpack_from("<i", data, at + 4))
    return at + 24 + 8 * len(pycolmap.Camera.create_from_model_id(1, model, 1.0, 1, 1).params)


def _after_image(data: bytes, at: int) -> int:
    """Return where the entry ends: id, pose and camera, name, number of points and points."""
    end = data.index(b"\0", at + 64)
    data[at + 64 : end].decode()
    return end + 9 + 24 * int(struct.unpack_from("<Q", data, end + 1)[0])


def _after_point(data: bytes, at: int) -> int:
    """Return where the entry ends: id, position, colour and error, length of the track and track."""
    return at + 51 + 8 * int(struct.unpack_from("<Q", data, at + 43)[0])


def _check_text(path: Path, least: int, numeric: Iterable[int], *, images: bool) -> None:
    rows = [(line, text) for line, text in enumerate(read_text(path).splitlines(), 1) if not text.startswith("#")]
    if images:
        # Two lines per photograph, the second without points is empty; blank lines before the first do not count.
        first = next((index for index, (_, text) in enumerate(rows) if text.strip()), 0)
        rows = rows[first::2]
    for line, text in rows:
        values = text.split()
        if values and len(values) < least:
            raise DatasetError(f"{path}, line {line}: {len(values)} values, expected {least} or more")
        if images and len(values) > least:
            name = " ".join(values[least - 1 :])
            raise DatasetError(f"{path}, line {line}: COLMAP's text holds no name with a blank: {name!r}; take .bin")
        for index in numeric if values else ():
            if np.isnan(number(values[index])):
                raise DatasetError(f"{path}, line {line}: {values[index]!r} is no number")
