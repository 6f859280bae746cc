"""The matches of a pair that estimators are given, made in every way that is compared, once for all estimators.

- ``standard``: X_L of the paper, nearest neighbours of plain SIFT by distance ratio; its baseline.
- ``snn``: RootSIFT, mutual nearest neighbours, ratio below 0.85; the strongest simple pipeline of today.
- ``generalized``: all matches above a similarity with low probabilities; what `generalized-ransac` gets for X_L.
- ``paper``, ``default``: the ranked matches of the preset, one set per roll hypothesis.
- any other name: a peer, a ranker of others on the same features, made elsewhere. ``FOLDER/PEER/PAIR_ID.npz`` holds
  its matches, best first: ``x1, x2`` of shape (N, 2), pixels of the images as given; ``scale1, scale2,
  orientation1_deg, orientation2_deg`` of the features and ``feature1, feature2``, their indices; all of length N.

Matches are kept in files, one per pair and input. This module imports no estimator, so that a changed estimator leaves
stored matches as they are.
"""

from __future__ import annotations

import pickle
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior.matching.baselines import generalized_matches, snn_matches, standard_matches
from epiprior.rank import rank_matches
from epiprior.types import MatchSet
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.detection import DetectedPair, detect_pair
from epiprior_lab.pairsets import DatasetError, Pair

WITHOUT = ("standard", "generalized")  # what an estimator gets without the preprocessing step
BASELINES = ("standard", "snn", "generalized")
PRESETS = ("paper", "default")
INPUTS = BASELINES + PRESETS
PREPROCESSED = "default"  # what a cascade falls back on

_MAKERS: Mapping[str, Callable[..., MatchSet]] = {
    "standard": standard_matches,
    "snn": snn_matches,
    "generalized": generalized_matches,
}


@dataclass(frozen=True, kw_only=True)
class PairMatches:
    """The matches of one pair.

    `sets` per input: presets have one set per roll hypothesis, all others a single one. `pixel_factors` are given
    pixels per working pixel of both images, `features` the numbers of their features.
    """

    sets: dict[str, tuple[MatchSet, ...]]
    pixel_factors: tuple[float, float]
    features: tuple[int, int] = (0, 0)


def match_pair(pair: Pair, inputs: Sequence[str], *, detected: DetectedPair | None = None) -> PairMatches:
    """Match one pair in every asked way, in that order; its images are read unless `detected` holds their features.

    SettingsError if an input is unknown.
    """
    return match_detected(detected or detect_pair(pair), inputs)


def match_detected(found: DetectedPair, inputs: Sequence[str]) -> PairMatches:
    """Match two images whose features are found in every asked way; SettingsError if an input is unknown."""
    unknown = [name for name in inputs if name not in INPUTS]
    if unknown:
        raise SettingsError(f"input is {unknown[0]!r}, known: {', '.join(INPUTS)}")
    (photo1, photo2), (features1, features2) = found.photographs, found.features
    sets: dict[str, tuple[MatchSet, ...]] = {}
    for name in inputs:
        if name in _MAKERS:
            sets[name] = (_MAKERS[name](photo1, photo2, features1=features1, features2=features2),)
        else:
            ranked = rank_matches(photo1, photo2, preset=name, features1=features1, features2=features2)
            sets[name] = ranked.sets
    return PairMatches(sets=sets, pixel_factors=found.pixel_factors, features=(len(features1), len(features2)))


@dataclass(frozen=True, kw_only=True)
class MatchFiles:
    """Where the matches of one pair are kept: `paths` holds a file per input, the rest is as in `PairMatches`."""

    paths: dict[str, Path]
    pixel_factors: tuple[float, float]
    features: tuple[int, int] = (0, 0)

    def only(self, inputs: Sequence[str]) -> MatchFiles:
        """Return the files of some inputs."""
        return replace(self, paths={name: self.paths[name] for name in inputs})

    def read(self) -> PairMatches:
        """Return the matches."""
        sets = {name: pickle.loads(path.read_bytes()) for name, path in self.paths.items()}
        return PairMatches(sets=sets, pixel_factors=self.pixel_factors, features=self.features)


def store_matches(
    pairs: Sequence[Pair],
    inputs: Sequence[str],
    folder: Path,
    *,
    peers: Path | None = None,
    files: Sequence[Path] = (),
    workers: int = 1,
    description: str = "match",
) -> list[MatchFiles]:
    """Match pairs in parallel and keep their matches in files in `folder`; a killed run continues.

    `inputs`, at least one, are names out of `INPUTS` or of peers, whose folder is `peers`. `files` decide the matches
    beside the pairs' own images: the model files. DatasetError if there is no such folder, or a file in it is missing
    or damaged.
    """
    own = tuple(name for name in inputs if name in INPUTS)
    others = [name for name in inputs if name not in INPUTS]
    if others and peers is None:
        raise DatasetError(f"no folder with the matches of {', '.join(others)}")
    tasks = [
        Task(name=pair.pair_id, payload={"pair": pair, "inputs": own}, files=(*pair.files, *files)) for pair in pairs
    ]
    matched = map_tasks(match_pair, tasks, workers=workers, description=description, store=folder)
    kept = []
    for pair, matches in zip(pairs, matched, strict=True):
        sets = dict(matches.sets)
        sizes = next(iter(sets.values()))[0].image_sizes
        for name in others:
            path = Path(peers or ".") / name / f"{pair.pair_id}.npz"
            sets[name] = (replace(read_peer_matches(path), image_sizes=sizes),)
        paths = {name: folder / f"{pair.pair_id}.{name}.matches" for name in inputs}
        for name, path in paths.items():
            path.write_bytes(pickle.dumps(sets[name], protocol=5))
        kept.append(MatchFiles(paths=paths, pixel_factors=matches.pixel_factors, features=matches.features))
    return kept


@contextmanager
def match_folder(store: Path | None) -> Iterator[Path]:
    """Yield a folder for matches: beside the stored results, or for this run alone."""
    if store is not None:
        yield store / "matches"
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def model_files(models: Path, inputs: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of the models that the inputs need, sorted: they decide the matches."""
    found = (models / name for name in inputs if name in PRESETS)
    return tuple(sorted(path for folder in found for path in folder.iterdir() if path.is_file()))


_COLUMNS = ("x1", "x2", "scale1", "scale2", "orientation1_deg", "orientation2_deg")
_INDICES = ("feature1", "feature2")


def read_peer_matches(path: Path) -> MatchSet:
    """Return the matches of one file of a peer: without probabilities, in the order of the file.

    DatasetError if it cannot be read, lacks an array, or its arrays do not belong together; the message names it.
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
