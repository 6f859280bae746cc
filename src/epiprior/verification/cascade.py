"""When an estimate on standard matches is good enough to do without preprocessing (paper, end of the results).

The paper recommends preprocessing "only on challenging image pairs or when the standard method failed". Here the
standard method fails if its confidence is too low. One number serves all estimators; it is chosen on validation scenes
and kept in ``models/cascade.json``.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from epiprior.settings_file import find_settings_file, parse_settings, read_settings_file
from epiprior.types import FundamentalEstimate, Status
from epiprior.verification.confidence import check_min_confidence


@dataclass(frozen=True, kw_only=True)
class CascadeRule:
    """The least confidence, in [0, 1], of an estimate on standard matches that is kept; SettingsError outside."""

    min_confidence: float = 0.9

    def __post_init__(self) -> None:
        check_min_confidence(self.min_confidence)

    def keeps(self, estimate: FundamentalEstimate) -> bool:
        """Return whether an estimate on standard matches is kept, so that nothing is preprocessed."""
        return self.keeps_numbers(estimate.status, estimate.confidence)

    def keeps_numbers(self, status: str, confidence: float) -> bool:
        """Return the same from the status of an estimate and its confidence alone."""
        return status == Status.OK and confidence >= self.min_confidence  # NaN is not


def load_cascade_rule(path: Path | None = None) -> CascadeRule:
    """Return the rule of the cascade: JSON of the form ``{"min_confidence": ...}``.

    None: the file that comes with the models; where there is none, the defaults of `CascadeRule`. Raises SettingsError
    if the file cannot be read, or names a value that does not exist or is out of range.
    """
    found = path or find_settings_file("cascade.json")
    return CascadeRule() if found is None else parse_settings(str(found), read_settings_file(found), CascadeRule())


def save_cascade_rule(path: Path, rule: CascadeRule) -> None:
    """Write what `load_cascade_rule` reads; the same rule gives the same bytes."""
    path.write_text(json.dumps(asdict(rule), indent=2, sort_keys=True) + "\n", encoding="utf-8", newline="\n")
