"""The parameters of the study: strict dataclasses over ``params.yaml``.

Every key must be there, of its type and in its range. There are no defaults here: the file says everything.
"""

import dataclasses
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml

from epiprior.errors import SettingsError

Split = Literal["train", "validation", "test"]
Preset = Literal["paper", "default"]
Input = Literal["standard", "snn", "paper", "default"]


@dataclass(frozen=True)
class Range:
    """Inclusive bounds of a number, or of every number in a tuple."""

    low: float
    high: float


Seed = Annotated[int, Range(0, 2**31 - 1)]
Probability = Annotated[float, Range(0, 1)]
Pixels = Annotated[float, Range(0.01, 1000)]
Rows = Annotated[int, Range(100, 10**8)]


@dataclass(frozen=True, kw_only=True)
class Section:
    """Base of all sections: checks types and ranges of its fields when it is made.

    Raises
    ------
    SettingsError
        If a field has a wrong type, is out of range, or is an empty or repeating list. The message names it.
    """

    def __post_init__(self) -> None:
        for name, hint in typing.get_type_hints(type(self), include_extras=True).items():
            _check(name, getattr(self, name), hint)


AnySection = typing.TypeVar("AnySection", bound=Section)


@dataclass(frozen=True, kw_only=True)
class PairCounts(Section):
    """Pairs of one family in each split."""

    train: Annotated[int, Range(1, 100_000)]
    validation: Annotated[int, Range(1, 100_000)]
    test: Annotated[int, Range(1, 100_000)]


@dataclass(frozen=True, kw_only=True)
class SceneParams(Section):
    """Rendered scenes."""

    seed: Seed
    families: tuple[str, ...]
    pairs: PairCounts
    image_width: Annotated[int, Range(64, 8192)]
    image_height: Annotated[int, Range(64, 8192)]
    jpeg_quality: Annotated[int, Range(1, 100)]


@dataclass(frozen=True, kw_only=True)
class GroundTruthParams(Section):
    """Control points, and when a match counts as right."""

    seed: Seed
    control_points: Annotated[int, Range(8, 100_000)]
    tolerance_px: Pixels
    tolerance_sigma: Annotated[float, Range(0, 10)]
    depth_tolerance: Annotated[float, Range(0, 1)]
    epipolar_px: Pixels


@dataclass(frozen=True, kw_only=True)
class FeatureParams(Section):
    """Candidate rows of the training pairs."""

    presets: tuple[Preset, ...]
    pair_sets: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ExportedFamilies(Section):
    """The family of classifiers that each preset ships."""

    paper: str
    default: str


@dataclass(frozen=True, kw_only=True)
class TrainParams(Section):
    """Cross-validation and refit of the classifiers."""

    seed: Seed
    folds: Annotated[int, Range(2, 100)]
    families: tuple[str, ...]
    exported: ExportedFamilies
    max_rows_per_pair: Rows
    max_rows: Rows
    max_forest_rows: Rows
    max_svm_rows: Rows

    def __post_init__(self) -> None:
        super().__post_init__()
        for preset, family in dataclasses.asdict(self.exported).items():
            if family not in self.families:
                raise SettingsError(f"exported.{preset} = {family!r}: not among families {list(self.families)}")


@dataclass(frozen=True, kw_only=True)
class HandOverParams(Section):
    """Seeds and candidates of the choice of how matches are handed to each estimator."""

    seeds: tuple[Seed, ...]
    one_to_one: tuple[bool, ...]
    top_k: tuple[Annotated[int, Range(8, 1_000_000)] | None, ...]
    min_probability: tuple[Probability | None, ...]
    max_distance_ratio: tuple[Probability, ...]
    threshold_px: tuple[Pixels, ...]
    spread: tuple[Annotated[float, Range(0.001, 1)] | None, ...]
    collect: tuple[bool, ...]
    refine: tuple[bool, ...]


@dataclass(frozen=True, kw_only=True)
class EvaluateParams(Section):
    """Estimators, inputs and repetitions of the evaluation."""

    seeds: tuple[Seed, ...]
    estimators: tuple[str, ...]
    inputs: tuple[Input, ...]


@dataclass(frozen=True, kw_only=True)
class ReportParams(Section):
    """Thresholds of success and the bootstrap."""

    seed: Seed
    success_px: Pixels
    strict_px: Pixels
    bootstrap_draws: Annotated[int, Range(100, 1_000_000)]
    contact_sheet_pairs: Annotated[int, Range(1, 100)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.strict_px > self.success_px:
            raise SettingsError(f"strict_px = {self.strict_px}: above success_px = {self.success_px}")


@dataclass(frozen=True, kw_only=True)
class Params(Section):
    """All parameters of the study, one field per section of the file."""

    scenes: SceneParams
    ground_truth: GroundTruthParams
    features: FeatureParams
    train: TrainParams
    hand_over: HandOverParams
    evaluate: EvaluateParams
    report: ReportParams


def load_params(path: Path | str = "params.yaml") -> Params:
    """Read and check a parameter file.

    Parameters
    ----------
    path : Path or str
        YAML file; the default is the study's, relative to the working directory: DVC runs stages at the root.

    Returns
    -------
    Params
        All sections.

    Raises
    ------
    SettingsError
        If the file cannot be read, or a key is unknown, missing, of a wrong type or out of its range. The
        message names the file and the key.
    """
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"{path}: cannot be read as YAML: {error}") from error
    try:
        return _build(Params, document, "")
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


def _build(section: type[AnySection], document: Any, prefix: str) -> AnySection:
    """Make a section of a mapping, its sub-sections first; keys in messages are dotted from the root."""
    if not isinstance(document, Mapping):
        raise SettingsError(f"{prefix.rstrip('.') or 'document'}: expected a mapping, got {document!r}")
    hints = typing.get_type_hints(section)
    unknown = [str(key) for key in document if key not in hints]
    missing = [key for key in hints if key not in document]
    if unknown:
        raise SettingsError(f"unknown key {prefix}{unknown[0]}; known are {', '.join(hints)}")
    if missing:
        raise SettingsError(f"missing key {prefix}{missing[0]}")
    values = {}
    for key, hint in hints.items():
        value = document[key]
        if isinstance(hint, type) and issubclass(hint, Section):
            value = _build(hint, value, f"{prefix}{key}.")
        elif isinstance(value, list):
            value = tuple(value)
        values[key] = value
    try:
        return section(**values)
    except SettingsError as error:
        raise SettingsError(f"{prefix}{error}") from error


def _check(name: str, value: Any, hint: Any) -> None:
    """Check one value against its annotation; `hint` is made of the few forms that the sections above use."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        _check(name, value, arguments[0])
        low, high = arguments[1].low, arguments[1].high
        if not low <= value <= high:  # also refuses NaN
            raise SettingsError(f"{name} = {value!r}: expected {low} to {high}")
    elif origin in (types.UnionType, typing.Union):
        if value is not None:
            _check(name, value, arguments[0])
    elif origin is tuple:
        if not isinstance(value, tuple) or not value:
            raise SettingsError(f"{name} = {value!r}: expected a list of one or more values")
        for item in value:
            _check(name, item, arguments[0])
        if len(set(value)) < len(value):
            raise SettingsError(f"{name} = {value!r}: a value is repeated")
    elif origin is Literal:
        if value not in arguments:
            raise SettingsError(f"{name} = {value!r}: expected one of {', '.join(map(str, arguments))}")
    else:
        accepted = (int, float) if hint is float else hint
        if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
            raise SettingsError(f"{name} = {value!r}: expected {hint.__name__}")
