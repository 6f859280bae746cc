"""When an estimate on standard matches is good enough to do without preprocessing (paper, end of the results).

The paper recommends preprocessing "only on challenging image pairs or when the standard method failed". Here the
standard method fails if it gives no F, or one whose support or share of inliers is low. How low is chosen per
estimator on validation scenes and kept in ``models/cascade.json``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior.settings_file import find_settings_file, read_settings_file
from epiprior.types import FundamentalEstimate, Status


@dataclass(frozen=True, kw_only=True)
class CascadeRule:
    """The least that an estimate on standard matches must show to be kept.

    Parameters
    ----------
    min_support : int
        Inliers, >= 0.
    min_inlier_ratio : float
        Inliers over the matches among which they were counted, in [0, 1]: those handed to the estimator, or,
        where the hand-over collects support again, those collected.

    Raises
    ------
    SettingsError
        If a value is out of its range.
    """

    min_support: int = 100
    min_inlier_ratio: float = 0.5

    def __post_init__(self) -> None:
        support, ratio = self.min_support, self.min_inlier_ratio
        if isinstance(support, bool) or not isinstance(support, int) or support < 0:
            raise SettingsError(f"min_support is {support!r}, expected a whole number of at least 0")
        number = isinstance(ratio, int | float) and not isinstance(ratio, bool)
        if not number or not 0 <= ratio <= 1:  # also refuses NaN
            raise SettingsError(f"min_inlier_ratio is {ratio!r}, expected a number in [0, 1]")

    def keeps(self, estimate: FundamentalEstimate) -> bool:
        """Return whether an estimate on standard matches is kept, so that nothing is preprocessed."""
        return self.keeps_support(estimate.status, estimate.support, len(estimate.x1))

    def keeps_support(self, status: str, support: int, matches: int) -> bool:
        """Return the same from the numbers alone: the status, and how many of how many matches are inliers."""
        enough = support >= max(self.min_support, 1) and support >= self.min_inlier_ratio * matches
        return status == Status.OK and enough


def load_cascade_rules(path: Path | None = None) -> dict[str, CascadeRule]:
    """Return the rule of every estimator.

    Parameters
    ----------
    path : Path, optional
        JSON of the form ``{estimator: {"min_support": ..., "min_inlier_ratio": ...}}``, both for each estimator
        that it names; others keep the defaults of `CascadeRule`. None: the file that comes with the models; where
        there is none, the defaults for all.

    Raises
    ------
    SettingsError
        If the file cannot be read, names an estimator or a value that does not exist, or leaves out a value.
    """
    from epiprior.estimators import names

    table = {name: CascadeRule() for name in names()}
    found = path if path is not None else find_cascade_rules()
    if found is None:
        return table
    for estimator, values in read_settings_file(found).items():
        if estimator not in table:
            raise SettingsError(f"{found}: unknown estimator {estimator!r}, known: {', '.join(table)}")
        table[estimator] = _parse(f"{found}: {estimator}", values)
    return table


def save_cascade_rules(path: Path, table: Mapping[str, CascadeRule]) -> None:
    """Write what `load_cascade_rules` reads; the same table gives the same bytes."""
    plain = {name: asdict(rule) for name, rule in table.items()}
    path.write_text(json.dumps(plain, indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")


def find_cascade_rules() -> Path | None:
    """Return the file that comes with the models; None if there is none."""
    return find_settings_file("cascade.json")


def _parse(where: str, values: object) -> CascadeRule:
    if not isinstance(values, dict):
        raise SettingsError(f"{where}: {type(values).__name__}, expected an object")
    known = [field.name for field in fields(CascadeRule)]
    unknown = sorted(set(values) - set(known))
    missing = [name for name in known if name not in values]
    if unknown:
        raise SettingsError(f"{where}: unknown {', '.join(unknown)}; known: {', '.join(known)}")
    if missing:
        raise SettingsError(f"{where}: {missing[0]} is missing")
    try:
        return CascadeRule(**values)
    except SettingsError as error:
        raise SettingsError(f"{where}: {error}") from error
