"""COLMAP models: undistorted photographs with cameras, pairs by viewing angle, control points from tracks."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of
from epiprior_lab.pairsets.importers.sources import need_folder
from epiprior_lab.pairsets.importers.structure import DEFAULT_CHOICE, PairChoice, pairs_of_models

_NAMES = ("cameras", "images", "points3D")


def find_colmap(
    folder: Path, *, images: Path | None = None, scene: str | None = None, choice: PairChoice = DEFAULT_CHOICE
) -> list[FoundPair]:
    """Return pairs of a COLMAP model, or of each model of a workspace, a scene of its own.

    `folder` holds a model (``cameras``, ``images`` and ``points3D`` as ``.bin`` or ``.txt``), or models in ``sparse``
    or ``sparse/0``, ``sparse/1``, ...; `images` is by default ``images`` in it or in one of the two folders above;
    `scene` is by default the workspace's name. DatasetError for no pair, a missing model or photograph, or a bad file.
    """
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
    """Return the reconstruction of a model; DatasetError if a file is damaged."""
    import pycolmap

    if (model / "cameras.bin").is_file():
        for name, after in zip(_NAMES, (_after_camera, _after_image, _after_point), strict=True):
            _check_binary(model / f"{name}.bin", after)
    try:
        return pycolmap.Reconstruction(model)
    except (ValueError, IndexError, MemoryError, RuntimeError) as error:
        raise DatasetError(f"{model}: damaged COLMAP model: {error}") from error


def _check_binary(path: Path, after: Callable[[bytes, int], int]) -> None:
    """Walk through a file: pycolmap reads one that is cut off without an error, or never ends.

    DatasetError if it ends too early or late, or pycolmap cannot hold the name of an image.
    """
    done = 0
    try:
        data = path.read_bytes()
        (count,), at = struct.unpack_from("<Q", data), 8
        while done < count:
            at = after(data, at)
            if at > len(data):
                raise struct.error
            done += 1
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
