"""How the matches are handed to an estimator: cut and made one-to-one (beyond the paper, section 4.7).

`default_hand_over` holds a choice for every kind of estimator and input; what was chosen otherwise on validation scenes
is kept in ``models/hand_over.json``.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from epiprior.errors import SettingsError
from epiprior.estimators.registry import names
from epiprior.presets import check_choice, check_settings, in_range
from epiprior.settings_file import find_settings_file, parse_settings, read_settings_file
from epiprior.types import MatchSet

FILE = "hand_over.json"
INPUTS = ("standard", "snn", "generalized", "paper-standard", "paper", "default")
_TAKES_ORDER = frozenset({"usac", "magsac++", "gc-ransac", "prosac"})
_TAKES_WEIGHTS = frozenset({"guided-mlesac", "beem", "blogs", "generalized-ransac", "epiprior"})


@dataclass(frozen=True, kw_only=True)
class HandOver:
    """What an estimator gets of a ranked set, and what is done with its answer.

    Parameters
    ----------
    one_to_one : Walk down the ranking and skip a match whose feature was used before.
    top_k : At most so many matches, >= 8.
    max_distance_ratio : Only matches with d_r up to this, in (0, 1].
    threshold_px : Inlier threshold of the estimator, working pixels, > 0.
    collect : Collect support again over all one-to-one matches of the set, and let what they say for F
        (`SpreadEvidence`) decide between roll hypotheses. False: the inliers handed over (the paper).
    refine : Refine F on the matches that support is collected from, weighted by their probabilities.

    Raises
    ------
    SettingsError : If a value is out of its range.
    """

    one_to_one: bool = False
    top_k: int | None = in_range(8, math.inf, None)
    max_distance_ratio: float | None = in_range(1e-9, 1.0, None)
    threshold_px: float = in_range(1e-9, 1e9, 1.5)
    collect: bool = False
    refine: bool = False

    def __post_init__(self) -> None:
        check_settings(self)


def hand_over(matches: MatchSet, how: HandOver) -> MatchSet:
    """Return the matches that an estimator gets, sorted best first as they came: cut, one-to-one, at most `top_k`."""
    if how.max_distance_ratio is not None:
        matches = matches.take(matches.distance_ratio <= how.max_distance_ratio)
    if how.one_to_one:
        matches = matches.one_to_one()
    return matches if how.top_k is None else matches.take(slice(how.top_k))


def default_hand_over(estimator: str, kind: str) -> HandOver:
    """Return the hand-over for an estimator and an input (of `INPUTS`) where none was chosen on validation scenes.

    Estimators that weigh matches get most of a ranking, those that sample in order fewer, those that take no prior the
    fewest. Inputs: ``standard`` (X_L), the same on features of the preset `paper`, ``snn``,
    ``generalized`` (all matches above a similarity), and the names of models.
    """
    check_choice("input", kind, INPUTS)
    if kind in ("standard", "paper-standard"):
        return HandOver(max_distance_ratio=0.85)
    if kind in ("snn", "generalized"):
        return HandOver()
    if estimator == "epiprior":  # makes the matches one-to-one, weighs all of them, and refines
        return HandOver(collect=True)
    top_k = 1000 if estimator in _TAKES_WEIGHTS else 500 if estimator in _TAKES_ORDER else 300
    return HandOver(one_to_one=True, top_k=top_k, collect=kind == "default", refine=kind == "default")


def load_hand_overs(path: Path | None = None) -> dict[str, dict[str, HandOver]]:
    """Return the hand-over of every estimator and input; a file changes `default_hand_over` where it says so.

    The file is JSON, ``{estimator: {input: {field: value}}}``; None: the one that comes with the models, if there is
    one. Raises SettingsError if it cannot be read, or names an estimator, input or field that does not exist.
    """
    table = {name: {kind: default_hand_over(name, kind) for kind in INPUTS} for name in names()}
    found = path or find_settings_file(FILE)
    if found is None:
        return table
    for estimator, kinds in read_settings_file(found).items():
        if estimator not in table:
            raise SettingsError(f"{found}: unknown estimator {estimator!r}, known: {', '.join(table)}")
        if not isinstance(kinds, dict):
            raise SettingsError(f"{found}: {estimator} is {type(kinds).__name__}, expected an object")
        for kind, values in kinds.items():
            if kind not in INPUTS:
                raise SettingsError(f"{found}: unknown input {kind!r} of {estimator}, known: {', '.join(INPUTS)}")
            table[estimator][kind] = parse_settings(f"{found}: {estimator}, {kind}", values, table[estimator][kind])
    return table


def save_hand_overs(path: Path, table: Mapping[str, Mapping[str, HandOver]]) -> None:
    """Write what `load_hand_overs` reads: what differs from the defaults. The same table gives the same bytes."""
    exceptions: dict[str, dict[str, dict[str, Any]]] = {}
    for name, kinds in table.items():
        for kind, how in kinds.items():
            usual = asdict(default_hand_over(name, kind))
            other = {field: value for field, value in asdict(how).items() if value != usual[field]}
            if other:
                exceptions.setdefault(name, {})[kind] = other
    path.write_text(json.dumps(exceptions, indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")
