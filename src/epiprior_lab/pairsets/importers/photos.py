"""A folder of somebody's own photographs: structure from motion gives cameras, control points and pairs."""

import logging
from pathlib import Path
from typing import Any

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, name_of, progress_bar
from epiprior_lab.pairsets.importers.pycolmap_run import Matched, mapping_options, matched
from epiprior_lab.pairsets.importers.sources import SUFFIXES, files_of
from epiprior_lab.pairsets.importers.structure import PairChoice, pairs_of_models

logger = logging.getLogger(__name__)

_LEAST = 3


def find_photos(folder: Path, *, scene: str | None = None, choice: PairChoice | None = None) -> list[FoundPair]:
    """Return pairs of photographs whose cameras pycolmap can find.

    All pairs of photographs are matched, which suits up to some hundred of them. Photographs that do not fit together
    give several models, each a scene of its own (named `scene`, the folder's name by default, and a number); those
    that fit nowhere are left out with a warning.

    DatasetError if there are fewer than three photographs, two differ in their suffix only, or no pair is as `choice`
    asks; ImageError if one cannot be read; all are checked first. Ground truth by structure from motion favours pairs
    that SIFT can link, directly or through others.
    """
    choice = choice or PairChoice()
    paths = (path for path in files_of(folder, "*") if path.suffix.lower() in SUFFIXES)
    photographs = [Photograph(name=name_of(path.name), path=path) for path in paths]
    if len(photographs) < _LEAST:
        raise DatasetError(f"{folder}: {len(photographs)} photographs, expected {_LEAST} or more")
    with matched(photographs) as found:
        models = _map(found)
        pairs, placed = pairs_of_models(models, found.photographs.__getitem__, scene or folder.resolve().name, choice)
    left_out = [photograph.path.name for photograph in photographs if photograph.path not in placed]
    if left_out:
        logger.warning("%s: %d photographs fit nowhere: %s", folder, len(left_out), ", ".join(left_out))
    if not pairs:
        raise DatasetError(f"{folder}: no pair of {len(placed)} placed photographs with {choice}")
    return pairs


def _map(found: Matched) -> list[Any]:
    """Return the models of pycolmap's incremental mapping, the largest first; each has three photographs or more."""
    import pycolmap

    database, images, scratch, photographs = found
    options = mapping_options()
    options.min_model_size, options.extract_colors = _LEAST, False
    with progress_bar("structure from motion", len(photographs)) as advance:
        models = pycolmap.incremental_mapping(
            database, images, scratch, options, initial_image_pair_callback=advance, next_image_callback=advance
        )
    return sorted(models.values(), key=lambda model: -int(model.num_reg_images()))
