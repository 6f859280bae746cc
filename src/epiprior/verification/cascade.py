"""When an estimate on standard matches is good enough to do without preprocessing (paper, end of the results).

The paper recommends preprocessing "only on challenging image pairs or when the standard method failed". Here the
standard method fails if it gives no F, or one that two ordinary photographs could hardly have. One rule serves all
estimators; its number is chosen on validation scenes and kept in ``models/cascade.json``.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior.settings_file import find_settings_file, parse_settings, read_settings_file
from epiprior.types import FundamentalEstimate, Status


@dataclass(frozen=True, kw_only=True)
class CascadeRule:
    """The least that an estimate on standard matches must show to be kept.

    Parameters
    ----------
    min_plausibility : Of F (`epiprior.verification.measures`), in [0, 1]. One that is not known counts as 0.

    Raises
    ------
    SettingsError : If the value is out of its range.

    Notes
    -----
    Ours. Support and share of inliers tell less: on a repeated facade a wrong F has many inliers too, but needs cameras
    that do not exist.
    """

    min_plausibility: float = 0.93

    def __post_init__(self) -> None:
        value = self.min_plausibility
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 <= value <= 1:  # also refuses NaN
            raise SettingsError(f"min_plausibility is {value!r}, expected a number in [0, 1]")

    def keeps(self, estimate: FundamentalEstimate) -> bool:
        """Return whether an estimate on standard matches is kept, so that nothing is preprocessed."""
        return self.keeps_numbers(estimate.status, estimate.plausibility)

    def keeps_numbers(self, status: str, plausibility: float) -> bool:
        """Return the same from the status of an estimate and the plausibility of its F alone."""
        known = 0.0 if math.isnan(plausibility) else plausibility
        return status == Status.OK and known >= self.min_plausibility


def load_cascade_rule(path: Path | None = None) -> CascadeRule:
    """Return the rule of the cascade: JSON of the form ``{"min_plausibility": ...}``.

    None: the file that comes with the models; where there is none, the defaults of `CascadeRule`. Raises SettingsError
    if the file cannot be read, or names a value that does not exist or is out of range.
    """
    found = path if path is not None else find_cascade_rule()
    return CascadeRule() if found is None else parse_settings(str(found), read_settings_file(found), CascadeRule())


def save_cascade_rule(path: Path, rule: CascadeRule) -> None:
    """Write what `load_cascade_rule` reads; the same rule gives the same bytes."""
    path.write_text(json.dumps(asdict(rule), indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")


def find_cascade_rule() -> Path | None:
    """Return the file that comes with the models; None if there is none."""
    return find_settings_file("cascade.json")
