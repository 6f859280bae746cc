"""The matches of a pair, made in every way that the study compares, once for all estimators.

``standard``
    X_L of the paper: nearest neighbours of plain SIFT by distance ratio.
``snn``
    RootSIFT, mutual nearest neighbours, ratio below 0.85: the strongest simple pipeline of today.
``generalized``
    All matches above a similarity with low probabilities; what `generalized-ransac` gets in place of X_L.
``paper``, ``default``
    The ranked matches of the preset, one set per roll hypothesis.

Matches are kept in files, one per pair and input: estimators are many, and each needs a few inputs only. This
module imports no estimator, so that a changed estimator leaves stored matches as they are.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior.matching.baselines import generalized_matches, snn_matches, standard_matches
from epiprior.rank import rank_matches
from epiprior.types import MatchSet
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.features.detection import detect_pair
from epiprior_lab.pairsets import Pair

WITHOUT = ("standard", "generalized")  # what an estimator gets without the preprocessing step
BASELINES = ("standard", "snn", "generalized")
PRESETS = ("paper", "default")
INPUTS = BASELINES + PRESETS

_MAKERS: Mapping[str, Callable[..., MatchSet]] = {
    "standard": standard_matches,
    "snn": snn_matches,
    "generalized": generalized_matches,
}


@dataclass(frozen=True, kw_only=True)
class PairMatches:
    """The matches of one pair, made in several ways.

    Parameters
    ----------
    sets : dict of str to tuple of MatchSet
        Per input; baselines have one set, presets one per roll hypothesis.
    pixel_factors : tuple of float
        Given pixels per working pixel in both images, as `estimate_from_matches` wants them.
    """

    sets: dict[str, tuple[MatchSet, ...]]
    pixel_factors: tuple[float, float]


def match_pair(pair: Pair, inputs: Sequence[str]) -> PairMatches:
    """Match one pair in every asked way.

    Parameters
    ----------
    pair : Pair
        Its two images are read.
    inputs : sequence of str
        Names out of `INPUTS`.

    Returns
    -------
    PairMatches
        Inputs in the order that was asked for.

    Raises
    ------
    SettingsError
        If an input is unknown.
    """
    unknown = [name for name in inputs if name not in INPUTS]
    if unknown:
        raise SettingsError(f"input is {unknown[0]!r}, known: {', '.join(INPUTS)}")
    found = detect_pair(pair)
    (photo1, photo2), (features1, features2) = found.photographs, found.features
    sets: dict[str, tuple[MatchSet, ...]] = {}
    for name in inputs:
        if name in _MAKERS:
            sets[name] = (_MAKERS[name](photo1, photo2, features1=features1, features2=features2),)
        else:
            ranked = rank_matches(photo1, photo2, preset=name, features1=features1, features2=features2)
            sets[name] = ranked.sets
    return PairMatches(sets=sets, pixel_factors=found.pixel_factors)


@dataclass(frozen=True, kw_only=True)
class MatchFiles:
    """Where the matches of one pair are kept.

    Parameters
    ----------
    paths : dict of str to Path
        One file per input.
    pixel_factors : tuple of float
        As in `PairMatches`.
    """

    paths: dict[str, Path]
    pixel_factors: tuple[float, float]

    def only(self, inputs: Sequence[str]) -> MatchFiles:
        """Return the files of some inputs."""
        return MatchFiles(paths={name: self.paths[name] for name in inputs}, pixel_factors=self.pixel_factors)

    def read(self) -> PairMatches:
        """Return the matches."""
        sets = {name: pickle.loads(path.read_bytes()) for name, path in self.paths.items()}
        return PairMatches(sets=sets, pixel_factors=self.pixel_factors)


def store_matches(
    pairs: Sequence[Pair],
    inputs: Sequence[str],
    folder: Path,
    *,
    files: Sequence[Path] = (),
    workers: int = 1,
    description: str = "match",
    resume: bool = True,
) -> list[MatchFiles]:
    """Match pairs in parallel and keep their matches in files.

    Parameters
    ----------
    pairs : sequence of Pair
        Of different ids.
    inputs : sequence of str
        Names out of `INPUTS`.
    folder : Path
        Where matches go; made if absent.
    files : sequence of Path
        What decides the matches beside the pairs' own images: the model files.
    workers, description
        As for `epiprior_lab.compute.tasks.map_tasks`.
    resume : bool
        Whether results are kept in `folder` as `map_tasks` does, so that a killed run continues.
    """
    tasks = [
        Task(name=pair.pair_id, payload={"pair": pair, "inputs": tuple(inputs)}, files=(*pair.files, *files))
        for pair in pairs
    ]
    store = folder if resume else None
    matched = map_tasks(match_pair, tasks, workers=workers, description=description, store=store)
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    for pair, matches in zip(pairs, matched, strict=True):
        paths = {name: folder / f"{pair.pair_id}.{name}.matches" for name in matches.sets}
        for name, path in paths.items():
            path.write_bytes(pickle.dumps(matches.sets[name], protocol=5))
        kept.append(MatchFiles(paths=paths, pixel_factors=matches.pixel_factors))
    return kept


def model_files(models: Path, inputs: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of the models that the inputs need, sorted: they decide the matches."""
    found = (models / name for name in inputs if name in PRESETS)
    return tuple(sorted(path for folder in found for path in folder.iterdir() if path.is_file()))
