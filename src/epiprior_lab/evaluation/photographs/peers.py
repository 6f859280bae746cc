"""Rankers of others on the same features, whose matches lie in files: made elsewhere, in an environment of their own.

``FOLDER/RANKER/PAIR_ID.npz`` holds the kept matches, best first: ``x1, x2`` of shape (N, 2), pixels of the images as
given; ``scale1, scale2`` and ``orientation1_deg, orientation2_deg`` of the features, ``feature1, feature2``, their
indices; all of length N.
"""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.types import MatchSet
from epiprior_lab.features.matching import MatchFiles
from epiprior_lab.pairsets import DatasetError, Pair

_COLUMNS = ("x1", "x2", "scale1", "scale2", "orientation1_deg", "orientation2_deg")
_INDICES = ("feature1", "feature2")


def read_peer_matches(path: Path) -> MatchSet:
    """Return the matches of one file: without probabilities, in the order of the file.

    Raises
    ------
    DatasetError
        If the file cannot be read, lacks an array, or its arrays do not belong together; the message names it.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            values: dict[str, Any] = {name: np.asarray(archive[name], np.float64) for name in _COLUMNS}
            values |= {name: np.asarray(archive[name], np.int64) for name in _INDICES}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path}: no matches of a peer: {error}") from error
    n = len(values["x1"])
    wrong = [name for name, value in values.items() if value.shape != ((n, 2) if name in ("x1", "x2") else (n,))]
    if wrong:
        raise DatasetError(f"{path}: {wrong[0]} has shape {values[wrong[0]].shape}, expected as many as x1")
    if not all(np.isfinite(value).all() for value in values.values()):
        raise DatasetError(f"{path}: a value is not finite")
    return MatchSet(
        **values,
        probability=np.full(n, np.nan),
        supporting_matrices=np.zeros(n, np.int64),
        distance_ratio=np.linspace(0, 1, n, endpoint=False),  # keeps the order where an estimator asks for a ratio
        similarity_weight=np.zeros(n),
        similarity=np.zeros(n),
        two_keypoint_probability=np.zeros(n),
    )


def store_peer_matches(
    pairs: Sequence[Pair], matched: Sequence[MatchFiles], rankers: Sequence[str], peers: Path | None, folder: Path
) -> list[MatchFiles]:
    """Add the matches of peers to those of the pairs.

    Parameters
    ----------
    pairs : sequence of Pair
        In the order of `matched`.
    matched : sequence of MatchFiles
        What is there already.
    rankers : sequence of str
        Names of the peers; none changes nothing.
    peers : Path, optional
        Their folder.
    folder : Path
        Where stored matches go.

    Raises
    ------
    DatasetError
        If there is no folder, or a file is missing or damaged.
    """
    if not rankers:
        return list(matched)
    if peers is None:
        raise DatasetError(f"no folder with the matches of {', '.join(rankers)}")
    kept = []
    for pair, matches in zip(pairs, matched, strict=True):
        paths = dict(matches.paths)
        sizes = next(iter(matches.read().sets.values()))[0].image_sizes
        for ranker in rankers:
            found = replace(read_peer_matches(peers / ranker / f"{pair.pair_id}.npz"), image_sizes=sizes)
            paths[ranker] = folder / f"{pair.pair_id}.{ranker}.matches"
            paths[ranker].write_bytes(pickle.dumps((found,), protocol=5))
        kept.append(MatchFiles(paths=paths, pixel_factors=matches.pixel_factors))
    return kept
