"""How the matches are handed to an estimator: cut, made one-to-one, spread (beyond the paper, section 4.7).

Which hand-over suits which estimator is chosen on validation scenes and kept in ``models/hand_over.json``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from epiprior.errors import FeatureError, SettingsError
from epiprior.types import BoolArray, FloatArray, IntArray, MatchSet

INPUTS = ("standard", "snn", "paper", "default")
_TAKES_ORDER = frozenset({"usac", "magsac++", "gc-ransac", "prosac"})
_GRID = 8


@dataclass(frozen=True, kw_only=True)
class HandOver:
    """What an estimator gets of a ranked set, and what is done with its answer.

    Parameters
    ----------
    one_to_one : bool
        Walk down the ranking and skip a match whose feature was used before.
    top_k : int or None
        At most so many matches, >= 8.
    min_probability : float or None
        Only matches at least so probable, in [0, 1]; the matches must carry probabilities.
    max_distance_ratio : float or None
        Only matches with d_r up to this, in (0, 1].
    spread : float or None
        Walk down the ranking and skip a match if the cell of an 8 x 8 grid that it lies in, in either image,
        holds this share of `top_k` already (of all matches, if `top_k` is None); in (0, 1]. Against best
        matches that crowd in one corner.
    threshold_px : float
        Inlier threshold of the estimator, working pixels, > 0.
    collect : bool
        Collect support again over all one-to-one matches of the set, each weighted by its probability, and
        let this decide between roll hypotheses. False: the number of inliers among the matches handed over
        (the paper).
    refine : bool
        Refine F on the matches that support is collected from, weighted by their probabilities.

    Raises
    ------
    SettingsError
        If a value is out of its range.
    """

    one_to_one: bool = False
    top_k: int | None = None
    min_probability: float | None = None
    max_distance_ratio: float | None = None
    spread: float | None = None
    threshold_px: float = 1.5
    collect: bool = False
    refine: bool = False

    def __post_init__(self) -> None:
        for name in ("one_to_one", "collect", "refine"):
            if not isinstance(getattr(self, name), bool):
                raise SettingsError(f"{name} is {getattr(self, name)!r}, expected true or false")
        if self.top_k is not None and (not isinstance(self.top_k, int) or isinstance(self.top_k, bool)):
            raise SettingsError(f"top_k is {self.top_k!r}, expected a whole number or nothing")
        self._check("top_k", 8, math.inf)
        self._check("min_probability", 0.0, 1.0)
        self._check("max_distance_ratio", 1e-9, 1.0)
        self._check("spread", 1e-9, 1.0)
        self._check("threshold_px", 1e-9, 1e9)

    def _check(self, name: str, low: float, high: float) -> None:
        value = getattr(self, name)
        if value is None and name != "threshold_px":
            return
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise SettingsError(f"{name} is {value!r}, expected a number in [{low:g}, {high:g}]")


@numba.njit(cache=True, nogil=True)
def _walk(feature1, feature2, used1, used2):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(feature1), np.bool_)
    for m in range(len(feature1)):
        i, j = feature1[m], feature2[m]
        if not used1[i] and not used2[j]:
            used1[i] = used2[j] = True
            keep[m] = True
    return keep


@numba.njit(cache=True, nogil=True)
def _walk_cells(cell1, cell2, cells, limit, wanted):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(cell1), np.bool_)
    held1 = np.zeros(cells, np.int64)
    held2 = np.zeros(cells, np.int64)
    taken = 0
    for m in range(len(cell1)):
        if taken == wanted:
            break
        i, j = cell1[m], cell2[m]
        if held1[i] < limit and held2[j] < limit:
            held1[i] += 1
            held2[j] += 1
            taken += 1
            keep[m] = True
    return keep


def one_to_one_mask(feature1: IntArray, feature2: IntArray) -> BoolArray:
    """Return which matches remain if a match is skipped whose feature, in either image, was used before.

    Parameters
    ----------
    feature1, feature2 : ndarray, shape (N,), int
        Features of the matches, best match first; any numbers >= 0.

    Returns
    -------
    ndarray, shape (N,), bool
        A greedy matching: no match could be added to it.

    Raises
    ------
    FeatureError
        If shapes disagree or a number is negative.
    """
    first, second = np.asarray(feature1, dtype=np.int64), np.asarray(feature2, dtype=np.int64)
    if first.shape != second.shape or first.ndim != 1:
        raise FeatureError(f"feature1 and feature2 have shapes {first.shape} and {second.shape}, expected (N,) twice")
    if not len(first):
        return np.zeros(0, dtype=np.bool_)
    if min(first.min(), second.min()) < 0:
        raise FeatureError(f"feature numbers must not be negative, found {min(first.min(), second.min())}")
    # Dense numbers keep the memory at the number of matches, whatever numbers the caller uses.
    unique1, dense1 = np.unique(first, return_inverse=True)
    unique2, dense2 = np.unique(second, return_inverse=True)
    mask: BoolArray = _walk(dense1, dense2, np.zeros(len(unique1), np.bool_), np.zeros(len(unique2), np.bool_))
    return mask


def spread_mask(x1: FloatArray, x2: FloatArray, *, top_k: int, share: float) -> BoolArray:
    """Return the first `top_k` matches of which no cell of a grid, in either image, holds more than a share.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, best first, pixels. The grid of 8 x 8 cells covers the rectangle that they fill in each
        image.
    top_k : int
        How many are wanted; fewer come back where the cells are full.
    share : float
        Most that one cell may hold, as a share of `top_k`; at least one match.
    """
    if not len(x1):
        return np.zeros(0, dtype=np.bool_)
    limit = max(1, math.ceil(share * top_k))
    mask: BoolArray = _walk_cells(_cells(x1), _cells(x2), _GRID * _GRID, limit, top_k)
    return mask


def _cells(x: FloatArray) -> IntArray:
    low = x.min(axis=0)
    size = np.maximum(np.ptp(x, axis=0) / _GRID, 1e-9)
    column_row = np.minimum(((x - low) / size).astype(np.int64), _GRID - 1)
    cells: IntArray = column_row[:, 1] * _GRID + column_row[:, 0]
    return cells


def hand_over(matches: MatchSet, how: HandOver) -> MatchSet:
    """Return the matches that an estimator gets, in the order of the ranking.

    Parameters
    ----------
    matches : MatchSet
        Sorted best first.
    how : HandOver
        Cuts come first, then one-to-one, then spread and `top_k`.

    Raises
    ------
    SettingsError
        If `how` cuts by probability and the matches carry none.
    """
    if how.min_probability is not None:
        if np.isnan(matches.probability).any():
            raise SettingsError(f"min_probability is {how.min_probability}, but the matches carry no probabilities")
        matches = matches.take(matches.probability >= how.min_probability)
    if how.max_distance_ratio is not None:
        matches = matches.take(matches.distance_ratio <= how.max_distance_ratio)
    if how.one_to_one:
        matches = matches.one_to_one()
    if how.spread is not None:
        wanted = how.top_k or max(len(matches), 1)
        matches = matches.take(spread_mask(matches.x1, matches.x2, top_k=wanted, share=how.spread))
    return matches if how.top_k is None else matches.take(slice(how.top_k))


def default_hand_over(estimator: str, kind: str) -> HandOver:
    """Return the hand-over for an estimator and an input where none was chosen on validation scenes.

    Parameters
    ----------
    estimator : str
        Name in the registry; those that sample in order get more matches than those that take no prior.
    kind : str
        ``standard`` (X_L), ``snn``, ``paper`` or ``default`` (the presets).

    Raises
    ------
    SettingsError
        If `kind` is another.
    """
    if kind == "standard":
        return HandOver(max_distance_ratio=0.85)
    if kind == "snn":
        return HandOver()
    if kind not in INPUTS:
        raise SettingsError(f"input is {kind!r}, known: {', '.join(INPUTS)}")
    improved = kind == "default"
    top_k = 500 if estimator in _TAKES_ORDER else 300
    return HandOver(one_to_one=True, top_k=top_k, collect=improved, refine=improved)


def load_hand_overs(path: Path | None = None) -> dict[str, dict[str, HandOver]]:
    """Return the hand-over of every estimator and input.

    Parameters
    ----------
    path : Path, optional
        JSON of the form ``{estimator: {input: {field: value}}}``; what it leaves out keeps its default. None:
        the file that comes with the models; where there is none, the defaults of `default_hand_over`.

    Raises
    ------
    SettingsError
        If the file cannot be read, or names an estimator, input or field that does not exist.
    """
    from epiprior.estimators import names

    table = {name: {kind: default_hand_over(name, kind) for kind in INPUTS} for name in names()}
    found = path if path is not None else find_hand_overs()
    if found is None:
        return table
    for estimator, kinds in _read(found).items():
        if estimator not in table:
            raise SettingsError(f"{found}: unknown estimator {estimator!r}, known: {', '.join(table)}")
        for kind, values in _object(found, estimator, kinds).items():
            if kind not in INPUTS:
                raise SettingsError(f"{found}: unknown input {kind!r} of {estimator}, known: {', '.join(INPUTS)}")
            table[estimator][kind] = _parse(f"{found}: {estimator}, {kind}", values, table[estimator][kind])
    return table


def save_hand_overs(path: Path, table: Mapping[str, Mapping[str, HandOver]]) -> None:
    """Write what `load_hand_overs` reads; the same table gives the same bytes."""
    plain = {name: {kind: asdict(how) for kind, how in kinds.items()} for name, kinds in table.items()}
    path.write_text(json.dumps(plain, indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")


def find_hand_overs() -> Path | None:
    """Return the file that comes with the models: in the wheel, or in a checkout; None if there is none."""
    package = Path(__file__).resolve().parent
    candidates = [package / "_models" / "hand_over.json"]
    if package.parent.name == "src":
        candidates.append(package.parents[1] / "models" / "hand_over.json")
    return next((path for path in candidates if path.is_file()), None)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SettingsError(f"{path}: not JSON: {error}") from error
    return _object(path, "the file", content)


def _object(path: Path, name: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SettingsError(f"{path}: {name} is {type(value).__name__}, expected an object")
    return value


def _parse(where: str, values: object, default: HandOver) -> HandOver:
    if not isinstance(values, dict):
        raise SettingsError(f"{where}: {type(values).__name__}, expected an object")
    unknown = sorted(set(values) - {f.name for f in fields(HandOver)})
    if unknown:
        raise SettingsError(
            f"{where}: unknown {', '.join(unknown)}; known: {', '.join(f.name for f in fields(HandOver))}"
        )
    try:
        return replace(default, **values)
    except SettingsError as error:
        raise SettingsError(f"{where}: {error}") from error
