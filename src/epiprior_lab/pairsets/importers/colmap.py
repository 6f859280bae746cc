"""COLMAP models: undistorted photographs with cameras, pairs by viewing angle, control points from tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.colmap_files import check_model
from epiprior_lab.pairsets.importers.images_beside import need_folder
from epiprior_lab.pairsets.importers.output import FoundPair
from epiprior_lab.pairsets.importers.structure import PairChoice, choose_pairs, views_of

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
        Folder of the photographs; ``images`` in `folder` or in one of the three folders above by default.
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
    models = find_models(need_folder(folder))
    images = images or _images_near(folder)
    scene = scene or images.resolve().parent.name
    pairs = []
    for number, model in enumerate(models):
        several = len(models) > 1
        views = views_of(_read(model), need_folder(images), prefix=f"{number}_" if several else "")
        pairs += choose_pairs(views, f"{scene}_{number}" if several else scene, choice)
    if not pairs:
        raise DatasetError(f"{folder}: no pair with {choice}")
    return pairs


def find_models(folder: Path) -> list[Path]:
    """Return the folders of the models of a workspace.

    Raises
    ------
    DatasetError
        If there is none.
    """
    for candidates in ([folder], sorted(folder.glob("sparse/*")), [folder / "sparse"]):
        models = [path for path in candidates if _is_model(path)]
        if models:
            return models
    raise DatasetError(f"{folder}: no COLMAP model: neither here nor in sparse are {', '.join(_NAMES)} (.bin or .txt)")


def _is_model(path: Path) -> bool:
    return any(all((path / f"{name}{suffix}").is_file() for name in _NAMES) for suffix in (".bin", ".txt"))


def _images_near(folder: Path) -> Path:
    resolved = folder.resolve()
    tried = [path / "images" for path in (resolved, *list(resolved.parents)[:2])]
    for path in tried:
        if path.is_dir():
            return path
    raise DatasetError(f"{folder}: no folder of images; tried {', '.join(map(str, tried))}; name it with --images")


def _read(model: Path) -> object:
    """Return the reconstruction of a model."""
    import pycolmap

    check_model(model)
    try:
        reconstruction = pycolmap.Reconstruction(model)
    except (ValueError, IndexError, MemoryError, RuntimeError) as error:
        raise DatasetError(f"{model}: damaged COLMAP model: {error}") from error
    for camera in reconstruction.cameras.values():
        if camera.width <= 0 or camera.height <= 0 or not np.isfinite(camera.params).all():
            raise DatasetError(f"{model}: camera {camera.camera_id} has an impossible size or parameters")
    return reconstruction
