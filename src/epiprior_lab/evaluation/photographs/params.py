"""The parameters of the second pipeline: strict dataclasses over ``benchmarks/real/params.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import yaml

from epiprior.errors import SettingsError
from epiprior_lab.labels.ground_truth import LabelSettings
from epiprior_lab.params import EvaluateParams, Pixels, Probability, Seed
from epiprior_lab.sections import Range, Section, build_section

PARAMS = Path("benchmarks/real/params.yaml")


@dataclass(frozen=True, kw_only=True)
class TruthParams(Section):
    """When a match counts as right, when a pair decides an F, and what makes a pair easy or hard."""

    tolerance_px: Pixels
    tolerance_sigma: Annotated[float, Range(0, 10)]
    depth_tolerance: Annotated[float, Range(0, 1)]
    epipolar_px: Pixels
    plane_px: Pixels
    one_plane: tuple[str, ...]
    easy_share: Probability
    hard_share: Probability

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hard_share > self.easy_share:
            raise SettingsError(f"hard_share = {self.hard_share}: above easy_share = {self.easy_share}")

    @property
    def labels(self) -> LabelSettings:
        """The tolerances of labels."""
        return LabelSettings(**{name: getattr(self, name) for name in LabelSettings.__dataclass_fields__})


@dataclass(frozen=True, kw_only=True)
class MeasureParams(Section):
    """The normalised symmetric geometric distance."""

    seed: Seed
    distance_points: Annotated[int, Range(10, 100_000)]


@dataclass(frozen=True, kw_only=True)
class TimingParams(Section):
    """Pairs and seeds on which time is measured."""

    pairs_per_set: Annotated[int, Range(1, 1000)]
    seeds: tuple[Seed, ...]
    median_overhead: Annotated[float, Range(1, 1000)]
    cascade_overhead: Annotated[float, Range(1, 1000)]


@dataclass(frozen=True, kw_only=True)
class GalleryParams(Section):
    """Whose rescued and lost pairs are shown, and how many."""

    estimator: str
    rescued: Annotated[int, Range(1, 100)]
    lost: Annotated[int, Range(1, 100)]


@dataclass(frozen=True, kw_only=True)
class RealBoundParams(Section):
    """What is wanted; the report says what was reached."""

    precision_gain: Annotated[float, Range(0, 1)]
    hard_gain: Annotated[float, Range(0, 100)]
    champion: str
    champion_gain: Mapping[str, Annotated[float, Range(0, 100)]]
    easy_loss: Probability

    @property
    def champion_gains(self) -> dict[float, float]:
        """What the champion shall gain over the best peer, by threshold in pixels."""
        return {float(threshold): gain for threshold, gain in self.champion_gain.items()}


@dataclass(frozen=True, kw_only=True)
class RealReportParams(Section):
    """Thresholds of success, the bootstrap, the gallery and the bounds."""

    seed: Seed
    success_px: Pixels
    thresholds_px: tuple[Pixels, ...]
    pose_deg: tuple[Annotated[float, Range(0.1, 90)], ...]
    distance_recall: Probability
    bootstrap_draws: Annotated[int, Range(100, 1_000_000)]
    gallery: GalleryParams
    bounds: RealBoundParams


@dataclass(frozen=True, kw_only=True)
class RealParams(Section):
    """All parameters, one field per section of the file.

    `sets` are folders below ``data/real``; those in `apart` are reported, but are part of no total. Inputs in `whole`
    are handed over as they are, whatever did best on rendered scenes; `peers` are rankers of others, whose matches lie
    in files (`epiprior_lab.evaluation.photographs.peers`), or null.
    """

    sets: tuple[str, ...]
    apart: tuple[str, ...]
    evaluate: EvaluateParams
    whole: tuple[str, ...]
    peers: tuple[str, ...] | None
    truth: TruthParams
    measures: MeasureParams
    timing: TimingParams
    report: RealReportParams

    def __post_init__(self) -> None:
        super().__post_init__()
        report, estimators = self.report, self.evaluate.estimators
        thresholds = tuple(f"{threshold:g}" for threshold in report.thresholds_px)
        for key, names, known in (
            ("apart", self.apart, self.sets),
            ("whole", self.whole, self.evaluate.all_inputs),
            ("report.gallery.estimator", (report.gallery.estimator,), estimators),
            ("report.bounds.champion", (report.bounds.champion,), estimators),
            ("report.bounds.champion_gain", tuple(report.bounds.champion_gain), thresholds),
            ("report.success_px", (f"{report.success_px:g}",), thresholds),
        ):
            unknown = [name for name in names if name not in known]
            if unknown:
                raise SettingsError(f"{key}: {unknown[0]!r} is not among {', '.join(known)}")

    @property
    def inputs(self) -> dict[str, tuple[str, ...]]:
        """The inputs that each estimator gets, those of peers last."""
        return {name: (*own, *(self.peers or ())) for name, own in self.evaluate.inputs_by_estimator.items()}


def load_real_params(path: Path | str = PARAMS) -> RealParams:
    """Read and check a parameter file.

    Raises
    ------
    SettingsError
        If the file cannot be read, or a key is unknown, missing, of a wrong type or out of its range. The message
        names the file and the key.
    """
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"{path}: cannot be read as YAML: {error}") from error
    try:
        return build_section(RealParams, document, "")
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error
