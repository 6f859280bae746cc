"""When an estimate on simple matches is good enough to do without preprocessing (paper, end of the results).

The paper recommends preprocessing "only on challenging image pairs or when the standard method failed". Here the
standard method is the strongest simple one, `epiprior.snn_matches`, and it fails if it is not sure: neither of its F,
nor that a homography relates the images. One number serves all estimators; it is chosen on validation scenes and kept
in ``models/cascade.json``.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from epiprior.presets import check_settings, in_range
from epiprior.settings_file import find_settings_file, parse_settings, read_settings_file
from epiprior.types import FundamentalEstimate, Geometry, Status

FLAT = (Geometry.PLANAR, Geometry.ROTATION, Geometry.IDENTICAL)


@dataclass(frozen=True, kw_only=True)
class CascadeRule:
    """The least confidence c, in [0, 1], of an estimate on simple matches that is kept; SettingsError outside.

    Where a homography relates the images, the estimate is kept if the confidence in F is at most 1 - c.
    """

    min_confidence: float = in_range(0.0, 1.0, 0.9)

    def __post_init__(self) -> None:
        check_settings(self)

    def keeps(self, estimate: FundamentalEstimate) -> bool:
        """Return whether an estimate on simple matches is kept, so that nothing is preprocessed."""
        return self.keeps_numbers(estimate.status, estimate.geometry, estimate.confidence)

    def keeps_numbers(self, status: str, geometry: str, confidence: float) -> bool:
        """Return the same from status, geometry and confidence of an estimate alone; NaN is not kept."""
        if geometry in FLAT:
            return confidence <= 1.0 - self.min_confidence
        return status == Status.OK and confidence >= self.min_confidence

    def choose(self, first: FundamentalEstimate, second: FundamentalEstimate) -> FundamentalEstimate:
        """Return what a cascade answers whose estimates on simple and on ranked matches are these."""
        back = says_more((first.status, first.geometry), (second.status, second.geometry))
        return first if back or self.keeps(first) else second


def says_more(first: tuple[str, str], second: tuple[str, str]) -> bool:
    """Return whether a cascade that went on falls back on its first estimate, by status and geometry of both.

    An F to rely on says more than a homography, and that more than nothing.
    """
    one, two = (2 if status == Status.OK else int(geometry in FLAT) for status, geometry in (first, second))
    return one > two


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
