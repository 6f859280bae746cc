"""Photographs through pycolmap: features and matches with fixed seeds, and pairs of a folder of one's own photographs.

Extraction and verification of a pair do not depend on the number of threads; what follows is run with one.
"""

import contextlib
import logging
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from epiprior.io.colmap import quiet
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, check_photographs, name_of, progress_bar
from epiprior_lab.pairsets.importers.sources import SUFFIXES, files_of
from epiprior_lab.pairsets.importers.structure import DEFAULT_CHOICE, PairChoice, pairs_of_models

logger = logging.getLogger(__name__)

SEED = 0
_FEATURES_SIDE = 1600
_LEAST = 3


class Matched(NamedTuple):
    """A database of pycolmap with all pairs of photographs matched, a folder of links to them, and one for its files.

    The photographs are called by the names that the database and the links have for them.
    """

    database: Path
    images: Path
    scratch: Path
    photographs: dict[str, Photograph]


@contextlib.contextmanager
def matched(photographs: Sequence[Photograph]) -> Iterator[Matched]:
    """Find SIFT features in photographs and match all pairs of them, in a folder that is removed afterwards.

    pycolmap's list of pairs separates names by blanks, and its names are UTF-8; so it sees links that are called by
    number, and files may be called as they like. Its log below errors is silent meanwhile. DatasetError if two
    photographs have one name in a pair set, or pycolmap finds nothing in one; ImageError if one cannot be decoded; all
    are checked first.
    """
    check_photographs(photographs)
    with tempfile.TemporaryDirectory() as scratch, quiet():
        root = Path(scratch)
        (root / "images").mkdir()
        (root / "model").mkdir()
        named = {f"{number:06}{one.path.suffix.lower()}": one for number, one in enumerate(photographs)}
        for name, photograph in named.items():
            try:
                (root / "images" / name).symlink_to(photograph.path.resolve())
            except OSError:  # no links here
                shutil.copyfile(photograph.path, root / "images" / name)
        found = Matched(root / "database.db", root / "images", root / "model", named)
        _match(found)
        yield found


def _match(found: Matched) -> None:
    import pycolmap

    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size, extraction.use_gpu = _FEATURES_SIDE, False
    mode, names = pycolmap.CameraMode.PER_IMAGE, list(found.photographs)
    with progress_bar("features", len(names)) as advance:
        for name, photograph in found.photographs.items():
            try:
                pycolmap.extract_features(
                    found.database, found.images, image_names=[name], camera_mode=mode, extraction_options=extraction
                )
            except (ValueError, RuntimeError) as error:
                raise DatasetError(f"{photograph.path}: pycolmap cannot read it: {error}") from error
            advance()
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.use_gpu = False
    verification.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = found.database.with_suffix(".pairs.txt")
    with progress_bar("matching", len(names)) as advance:
        for index, name in enumerate(names):
            lines = "".join(f"{name} {other}\n" for other in names[:index])
            pairing.match_list_path.write_text(lines, encoding="utf-8")
            if index:
                pycolmap.match_image_pairs(found.database, matching, pairing, verification)
            advance()


def mapping_options() -> Any:
    """Return pycolmap's options for mapping and triangulation that gives the same result each time."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, SEED
    return options


def find_photos(folder: Path, *, scene: str | None = None, choice: PairChoice = DEFAULT_CHOICE) -> list[FoundPair]:
    """Return pairs of photographs whose cameras pycolmap can find.

    All pairs of photographs are matched, which suits up to some hundred of them. Photographs that do not fit together
    give several models, each a scene of its own (named `scene`, the folder's name by default, and a number); those
    that fit nowhere are left out with a warning. Ground truth by structure from motion favours pairs that SIFT links.
    DatasetError if there are fewer than three photographs, two differ in their suffix only, or no pair is as `choice`
    asks; ImageError if one cannot be read; all are checked first.
    """
    import pycolmap

    paths = (path for path in files_of(folder, "*") if path.suffix.lower() in SUFFIXES)
    photographs = [Photograph(name=name_of(path.name), path=path) for path in paths]
    if len(photographs) < _LEAST:
        raise DatasetError(f"{folder}: {len(photographs)} photographs, expected {_LEAST} or more")
    with matched(photographs) as found:
        options = mapping_options()
        options.min_model_size, options.extract_colors = _LEAST, False
        with progress_bar("structure from motion", len(photographs)) as advance:
            mapped = pycolmap.incremental_mapping(
                *found[:3], options, initial_image_pair_callback=advance, next_image_callback=advance
            )
        models = sorted(mapped.values(), key=lambda model: -int(model.num_reg_images()))
        pairs, placed = pairs_of_models(models, found.photographs.__getitem__, scene or folder.resolve().name, choice)
    left_out = [photograph.path.name for photograph in photographs if photograph.path not in placed]
    if left_out:
        logger.warning("%s: %d photographs fit nowhere: %s", folder, len(left_out), ", ".join(left_out))
    if not pairs:
        raise DatasetError(f"{folder}: no pair of {len(placed)} placed photographs with {choice}")
    return pairs
