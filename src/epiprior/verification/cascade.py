"""When an estimate on standard matches is good enough to do without preprocessing (paper, end of the results).

The paper recommends preprocessing "only on challenging image pairs or when the standard method failed". Here the
standard method fails if it gives no F, if the inliers of F cover little of the images, or if two ordinary photographs
could hardly have it. One rule serves all estimators; its two numbers are chosen on validation scenes and kept in
``models/cascade.json``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from epiprior.errors import SettingsError
from epiprior.settings_file import find_settings_file, read_settings_file
from epiprior.types import FundamentalEstimate, Status


@dataclass(frozen=True, kw_only=True)
class CascadeRule:
    """The least that an estimate on standard matches must show to be kept.

    Parameters
    ----------
    min_spread : int
        Cells of 48 x 48 pixels with inliers, in each of the images (`epiprior.verification.spread`), >= 0.
    min_plausibility : float
        Of F (`epiprior.verification.plausibility`), in [0, 1]. One that is not known counts as 0.

    Raises
    ------
    SettingsError
        If a value is out of its range.

    Notes
    -----
    Ours. Support and share of inliers tell less: on a repeated facade a wrong F has many inliers too, but they lie
    close together, or need cameras that do not exist.
    """

    min_spread: int = 30
    min_plausibility: float = 0.93

    def __post_init__(self) -> None:
        spread, plausibility = self.min_spread, self.min_plausibility
        if isinstance(spread, bool) or not isinstance(spread, int) or spread < 0:
            raise SettingsError(f"min_spread is {spread!r}, expected a whole number of at least 0")
        number = isinstance(plausibility, int | float) and not isinstance(plausibility, bool)
        if not number or not 0 <= plausibility <= 1:  # also refuses NaN
            raise SettingsError(f"min_plausibility is {plausibility!r}, expected a number in [0, 1]")

    def keeps(self, estimate: FundamentalEstimate) -> bool:
        """Return whether an estimate on standard matches is kept, so that nothing is preprocessed."""
        return self.keeps_numbers(estimate.status, estimate.spread, estimate.plausibility)

    def keeps_numbers(self, status: str, spread: int, plausibility: float) -> bool:
        """Return the same from the status, the spread of the inliers and the plausibility of F alone."""
        known = 0.0 if math.isnan(plausibility) else plausibility
        return status == Status.OK and spread >= self.min_spread and known >= self.min_plausibility


def load_cascade_rule(path: Path | None = None) -> CascadeRule:
    """Return the rule of the cascade.

    Parameters
    ----------
    path : Path, optional
        JSON of the form ``{"min_spread": ..., "min_plausibility": ...}``. None: the file that comes with the models;
        where there is none, the defaults of `CascadeRule`.

    Raises
    ------
    SettingsError
        If the file cannot be read, names a value that does not exist, or leaves one out.
    """
    found = path if path is not None else find_cascade_rule()
    return CascadeRule() if found is None else _parse(str(found), read_settings_file(found))


def save_cascade_rule(path: Path, rule: CascadeRule) -> None:
    """Write what `load_cascade_rule` reads; the same rule gives the same bytes."""
    path.write_text(json.dumps(asdict(rule), indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")


def find_cascade_rule() -> Path | None:
    """Return the file that comes with the models; None if there is none."""
    return find_settings_file("cascade.json")


def _parse(where: str, values: Mapping[str, Any]) -> CascadeRule:
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
