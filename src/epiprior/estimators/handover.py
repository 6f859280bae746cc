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

import numpy as np

from epiprior.errors import SettingsError
from epiprior.matching.selection import spread_mask
from epiprior.settings_file import find_settings_file, read_settings_file
from epiprior.types import MatchSet

INPUTS = ("standard", "snn", "generalized", "paper", "default")
_TAKES_ORDER = frozenset({"usac", "magsac++", "gc-ransac", "prosac"})
_TAKES_WEIGHTS = frozenset({"guided-mlesac", "beem", "blogs", "generalized-ransac", "epiprior"})


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
        Collect support again over all one-to-one matches of the set, and let what they say for F
        (`epiprior.estimators.epiprior_evidence`) decide between roll hypotheses. False: the number of inliers
        among the matches handed over (the paper).
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
        Name in the registry; those that sample in order get more matches than those that take no prior, and
        those that weigh matches get most.
    kind : str
        ``standard`` (X_L), ``snn``, ``generalized`` (all matches above a similarity), ``paper`` or ``default``
        (the presets).

    Raises
    ------
    SettingsError
        If `kind` is another.
    """
    if kind == "standard":
        return HandOver(max_distance_ratio=0.85)
    if kind in ("snn", "generalized"):
        return HandOver()
    if kind not in INPUTS:
        raise SettingsError(f"input is {kind!r}, known: {', '.join(INPUTS)}")
    improved = kind == "default"
    if estimator == "epiprior":  # makes the matches one-to-one, weighs all of them, and refines
        return HandOver(collect=True)
    top_k = 1000 if estimator in _TAKES_WEIGHTS else 500 if estimator in _TAKES_ORDER else 300
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
    for estimator, kinds in read_settings_file(found).items():
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
    return find_settings_file("hand_over.json")


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
