"""The matches of a pair that estimators are given, made in every way that is compared, once for all estimators.

- ``standard``: X_L of the paper, nearest neighbours of plain SIFT by distance ratio; its baseline.
- ``snn``: RootSIFT, mutual nearest neighbours, ratio below 0.85; the strongest simple pipeline of today.
- ``generalized``: all matches above a similarity with low probabilities; what `generalized-ransac` gets for X_L.
- ``paper``, ``fast``, ``default``, ``thorough``: the ranked matches of the preset, one set per roll hypothesis.
- ``paper-standard``: X_L on the features of the preset `paper`; all other baselines are on those of `default`.
- any other name: a peer, matches of others, made elsewhere. ``FOLDER/PEER/PAIR_ID.npz`` holds them, best first: ``x1,
  x2`` of shape (N, 2), pixels of the images as given, and ``feature1, feature2``, indices of the features; where these
  have them, ``scale1, scale2, orientation1_deg, orientation2_deg``; all of length N. Features of the peer's own are
  counted in ``features`` (2,); else they are ours.

Matches are kept in files, one per pair and input. This module imports no estimator: stored matches outlive changes.
"""

import pickle
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior.matching.baselines import generalized_matches, snn_matches, standard_matches
from epiprior.presets import FeatureSettings, find_preset
from epiprior.rank import rank_matches
from epiprior.types import MatchSet
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.detection import DetectedPair, detect_images, detect_pair
from epiprior_lab.pairsets import DatasetError, Pair

PRESETS = ("paper", "fast", "default", "thorough")
FIRST = "snn"  # what a cascade tries first,
PREPROCESSED = "default"  # and what it goes on to

_MAKERS: Mapping[str, Callable[..., MatchSet]] = {
    "standard": standard_matches,
    "snn": snn_matches,
    "generalized": generalized_matches,
    "paper-standard": standard_matches,
}
INPUTS = (*_MAKERS, *PRESETS)


@dataclass(frozen=True, kw_only=True)
class PairMatches:
    """The matches of one pair.

    `sets` per input: presets have one set per roll hypothesis, all others a single one. `features` are how many both
    images had, per input. `pixel_factors` are given pixels per working pixel of both images.
    """

    sets: dict[str, tuple[MatchSet, ...]]
    pixel_factors: tuple[float, float]
    features: dict[str, tuple[int, int]] = field(default_factory=dict)


def match_pair(pair: Pair, inputs: Sequence[str]) -> PairMatches:
    """Match one pair in every asked way, in that order; SettingsError if an input is unknown."""
    return match_detected(detect_pair(pair), inputs)


def match_detected(found: DetectedPair, inputs: Sequence[str]) -> PairMatches:
    """Match two images whose features are found in every asked way; SettingsError if an input is unknown."""
    unknown = [name for name in inputs if name not in INPUTS]
    if unknown:
        raise SettingsError(f"input is {unknown[0]!r}, known: {', '.join(INPUTS)}")
    of_settings = {found.settings: found}
    sets: dict[str, tuple[MatchSet, ...]] = {}
    features: dict[str, tuple[int, int]] = {}
    for name in inputs:
        settings = detection_of(name)
        if settings not in of_settings:
            of_settings[settings] = detect_images(*found.photographs, settings)
        views, (first, second) = of_settings[settings].photographs, of_settings[settings].features
        features[name] = len(first), len(second)
        if name in _MAKERS:
            sets[name] = (_MAKERS[name](*views, features1=first, features2=second),)
        else:
            sets[name] = rank_matches(*views, preset=name, features1=first, features2=second).sets
    return PairMatches(sets=sets, features=features, pixel_factors=found.pixel_factors)


def detection_of(name: str) -> FeatureSettings:
    """Return how the features of an input are found; how their descriptors are normalised is another matter."""
    preset = "paper" if name == "paper-standard" else name if name in PRESETS else PREPROCESSED
    return replace(find_preset(preset).features, root=True, centred=True)


def store_matches(
    pairs: Sequence[Pair],
    inputs: Sequence[str],
    folder: Path,
    *,
    peers: Path | None = None,
    files: Sequence[Path] = (),
    description: str = "match",
) -> list[dict[str, Path]]:
    """Match pairs in parallel; return for each pair the files in `folder`, by input; a killed run continues.

    `inputs`, at least one, are names out of `INPUTS` or of peers, whose folder is `peers`. `files` decide the matches
    beside the pairs' own images: the model files. DatasetError if the folder or a file in it is missing or damaged.
    """
    own = tuple(name for name in inputs if name in INPUTS)
    others = [name for name in inputs if name not in INPUTS]
    if others and peers is None:
        raise DatasetError(f"no folder with the matches of {', '.join(others)}")
    tasks = [
        Task(name=pair.pair_id, payload={"pair": pair, "inputs": own}, files=(*pair.files, *files)) for pair in pairs
    ]
    kept = []
    for pair, matches in zip(pairs, map_tasks(match_pair, tasks, description=description, store=folder), strict=True):
        sets, features = dict(matches.sets), dict(matches.features)
        sizes = next(iter(sets.values()))[0].image_sizes
        for name in others:
            found, counts = read_peer_matches(Path(peers or ".") / name / f"{pair.pair_id}.npz")
            sets[name] = (replace(found, image_sizes=sizes),)
            features[name] = counts or next(iter(matches.features.values()))
        paths = {name: folder / f"{pair.pair_id}.{name}.matches" for name in inputs}
        for name, path in paths.items():
            one = replace(matches, sets={name: sets[name]}, features={name: features[name]})
            path.write_bytes(pickle.dumps(one, protocol=5))
        kept.append(paths)
    return kept


def read_matches(paths: Mapping[str, Path]) -> PairMatches:
    """Return the matches of one pair that `store_matches` kept, by input."""
    read: list[PairMatches] = [pickle.loads(path.read_bytes()) for path in paths.values()]
    sets = {name: sets for one in read for name, sets in one.sets.items()}
    features = {name: counts for one in read for name, counts in one.features.items()}
    return replace(read[0], sets=sets, features=features)


def model_files(models: Path, inputs: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of the models that the inputs need, sorted: they decide the matches."""
    found = {models / find_preset(name).model for name in inputs if name in PRESETS}
    return tuple(sorted(path for folder in found for path in folder.iterdir() if path.is_file()))


_FRAMES = ("scale1", "scale2", "orientation1_deg", "orientation2_deg")


def read_peer_matches(path: Path) -> tuple[MatchSet, tuple[int, int] | None]:
    """Return the matches of one file of a peer, as `peer_matches`, and how many features both images had, if it says.

    DatasetError if it cannot be read, lacks an array, or its arrays do not belong together; the message names it.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
            matches = peer_matches(arrays)
            counts = arrays.get("features")
            return matches, None if counts is None else (int(counts[0]), int(counts[1]))
    except (OSError, ValueError, KeyError, IndexError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path}: no matches of a peer: {error}") from error


def peer_matches(arrays: Mapping[str, Any]) -> MatchSet:
    """Return matches of the arrays of a peer's file: without probabilities, in their order.

    Without scales and orientations these are NaN. KeyError if an array is missing; ValueError if the shapes do not
    belong together, or a value is not finite; the message names the array.
    """
    values: dict[str, Any] = {name: np.asarray(arrays[name], np.float64) for name in ("x1", "x2")}
    values |= {name: np.asarray(arrays[name], np.int64) for name in ("feature1", "feature2")}
    if any(name in arrays for name in _FRAMES):
        values |= {name: np.asarray(arrays[name], np.float64) for name in _FRAMES}
    n = len(values["x1"])
    for name, value in values.items():
        if value.shape != ((n, 2) if name in ("x1", "x2") else (n,)):
            raise ValueError(f"{name} has shape {value.shape}, expected as many as x1")
        if not np.isfinite(value).all():
            raise ValueError(f"a value of {name} is not finite")
    return MatchSet(
        **dict.fromkeys(_FRAMES, np.full(n, np.nan)) | values,
        probability=np.full(n, np.nan),
        supporting_matrices=np.zeros(n, np.int64),
        distance_ratio=np.linspace(0, 1, n, endpoint=False),  # keeps the order where an estimator asks for a ratio
        similarity_weight=np.zeros(n),
        similarity=np.zeros(n),
        two_keypoint_probability=np.zeros(n),
    )
