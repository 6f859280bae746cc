"""A folder of somebody's own photographs: structure from motion gives cameras, control points and pairs."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

from epiprior_lab.pairsets import DatasetError, image_size
from epiprior_lab.pairsets.importers.images_beside import SUFFIXES, need_folder
from epiprior_lab.pairsets.importers.output import FoundPair
from epiprior_lab.pairsets.importers.pycolmap_run import map_images, match_images, quiet
from epiprior_lab.pairsets.importers.structure import PairChoice, choose_pairs, views_of

logger = logging.getLogger(__name__)

_FEATURES_SIDE = 1600
_LEAST = 3


def find_photos(folder: Path, *, scene: str | None = None, choice: PairChoice | None = None) -> list[FoundPair]:
    """Return pairs of photographs whose cameras pycolmap can find.

    All pairs of photographs are matched, which suits up to some hundred of them. Photographs that do not fit together
    give several models, each a scene of its own; those that fit nowhere are left out with a warning.

    Parameters
    ----------
    folder : Path
        The photographs.
    scene : str, optional
        Name of the scene; the folder's by default.
    choice : PairChoice, optional
        Which pairs.

    Raises
    ------
    DatasetError
        If there are fewer than three photographs, one cannot be read, or no pair is as `choice` asks.

    Notes
    -----
    Ground truth by structure from motion favours pairs that SIFT can link, directly or through others.
    """
    choice = choice or PairChoice()
    names = sorted(path.name for path in need_folder(folder).iterdir() if path.suffix.lower() in SUFFIXES)
    if len(names) < _LEAST:
        raise DatasetError(f"{folder}: {len(names)} photographs, expected {_LEAST} or more")
    for name in names:
        image_size(folder / name)
    scene = scene or folder.resolve().name
    with tempfile.TemporaryDirectory() as scratch, quiet():
        database = Path(scratch) / "database.db"
        match_images(database, folder, names, max_side=_FEATURES_SIDE)
        models = map_images(database, folder, Path(scratch) / "models", len(names))
    pairs = []
    placed: set[str] = set()
    for number, model in enumerate(models):
        several = len(models) > 1
        views = views_of(model, folder, prefix=f"{number}_" if several else "")
        placed |= {view.photograph.path.name for view in views}
        pairs += choose_pairs(views, f"{scene}_{number}" if several else scene, choice)
    left_out = [name for name in names if name not in placed]
    if left_out:
        logger.warning("%s: %d photographs fit nowhere: %s", folder, len(left_out), ", ".join(left_out))
    if not pairs:
        raise DatasetError(f"{folder}: no pair of {len(placed)} placed photographs with {choice}")
    return pairs
