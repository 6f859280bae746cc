"""The parameters of both pipelines: one strict schema over ``params.yaml`` and ``benchmarks/real/params.yaml``.

Every key must be there, of its type and in its range; there are no defaults. A section that is made by hand is checked
in the same way, and raises pydantic's ``ValidationError``, a ``ValueError``.
"""

import argparse
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import yaml
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails, PydanticCustomError

from epiprior.errors import SettingsError

STUDY = Path("params.yaml")
PHOTOGRAPHS = Path("benchmarks/real/params.yaml")

KINDS = ("pair", "unrelated", "doppelganger", "overlay", "plane", "rotation", "copy")


Split = Literal["train", "confidence", "validation", "test"]
Preset = Literal["paper", "default"]
Family = Literal["tree", "random-forest", "svm", "lightgbm"]
Input = Literal["standard", "snn", "generalized", "paper-standard", "paper", "fast", "default"]

SPLITS: tuple[Split, ...] = get_args(Split)

Value = TypeVar("Value")


def _no_repetition(values: tuple[Value, ...]) -> tuple[Value, ...]:
    if len(set(values)) < len(values):
        raise PydanticCustomError("repeated", "a value is repeated")
    return values


Listed = Annotated[tuple[Value, ...], Field(min_length=1), AfterValidator(_no_repetition)]
Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
Share = Annotated[float, Field(ge=0, le=1)]
Pixels = Annotated[float, Field(ge=0.01, le=1000)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Rows = Annotated[int, Field(ge=100, le=10**8)]
TopK = Annotated[int, Field(ge=8, le=1_000_000)]
ImageSize = Annotated[int, Field(ge=64, le=8192)]

STRICT = ConfigDict(extra="forbid", strict=True)
_BASELINES = frozenset({"standard", "generalized"})  # what an estimator gets without the preprocessing step
_DIFFICULTIES = ("easy", "medium", "hard")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class EvaluateParams:
    """Which pairs are evaluated, and by which estimators, inputs and seeds.

    `pairs` and `control_points` are folders with ``{group}`` for the name of a group. Inputs in `whole` are handed over
    as they are; `peers` are rankers and matchers of others, and `peer_estimators` those that get a peer's matches where
    not all do; groups in `apart` are reported, but are part of no total.
    """

    groups: Listed[str]
    pairs: str
    control_points: str | None
    out: str
    seeds: Listed[Seed]
    estimators: Listed[str]
    inputs: Listed[Input]
    other_inputs: Mapping[str, Listed[Input]]
    whole: Listed[Input] | None
    peers: Listed[str] | None
    peer_estimators: Mapping[str, Listed[str]] | None
    apart: Listed[str] | None

    def __post_init__(self) -> None:
        for key, template in (("pairs", self.pairs), ("control_points", self.control_points)):
            if template is not None and "{group}" not in template:
                raise ValueError(f"{key} = {template!r}: expected {{group}} in it")
        _check_known("other_inputs", self.other_inputs, self.estimators)
        for name, inputs in self.inputs_by_estimator.items():
            if len(_BASELINES.intersection(inputs)) != 1:
                raise ValueError(f"inputs of {name} are {', '.join(inputs)}: expected standard or generalized")
        asked = tuple(dict.fromkeys(name for inputs in self.inputs_by_estimator.values() for name in inputs))
        _check_known("whole", self.whole or (), asked)
        for peer, estimators in (self.peer_estimators or {}).items():
            _check_known("peer_estimators", (peer,), self.peers or (peer,))
            _check_known(f"peer_estimators.{peer}", estimators, self.estimators)
        _check_known("apart", self.apart or (), self.groups)

    @property
    def inputs_by_estimator(self) -> dict[str, tuple[str, ...]]:
        """The inputs that each estimator gets, without peers, in the order of `estimators`."""
        return {name: self.other_inputs.get(name, self.inputs) for name in self.estimators}

    @property
    def inputs_and_peers(self) -> dict[str, tuple[str, ...]]:
        """The inputs that each estimator gets, those of peers last."""
        of_peers = self.peer_estimators or {}
        return {
            name: (*own, *(peer for peer in self.peers or () if name in of_peers.get(peer, (name,))))
            for name, own in self.inputs_by_estimator.items()
        }

    def pairs_of(self, group: str) -> Path:
        """Return the folder of a group's pair set."""
        return Path(self.pairs.format(group=group))

    def control_points_of(self, group: str) -> Path | None:
        """Return the folder of a group's control points; None where they are part of the pair set."""
        return None if self.control_points is None else Path(self.control_points.format(group=group))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TruthParams:
    """When a match counts as right, when a pair decides an F, and what makes a pair easy or hard.

    A reprojection error is allowed up to the larger of `tolerance_px` and `tolerance_sigma` times the feature's sigma,
    since large features are located less well; a point is visible where depths differ relatively by less than
    `depth_tolerance`. Without depth, Sampson distances are up to `epipolar_px`. Control points within `plane_px` of one
    homography lie on one plane, and so do those of the pairs in `one_plane`. More than `easy_share` of X_L is right:
    easy; less than `hard_share`: hard.
    """

    tolerance_px: Pixels
    tolerance_sigma: Annotated[float, Field(ge=0, le=10)]
    depth_tolerance: Annotated[float, Field(gt=0, lt=1)]
    epipolar_px: Pixels
    plane_px: Pixels
    one_plane: Listed[str] | None
    easy_share: Share
    hard_share: Share

    def __post_init__(self) -> None:
        if self.hard_share > self.easy_share:
            raise ValueError(f"hard_share = {self.hard_share}: above easy_share = {self.easy_share}")

    def difficulty(self, right_share: float) -> str:
        """Return how hard a pair is by the share of right matches in X_L; empty where it is NaN."""
        if math.isnan(right_share):
            return ""
        if right_share > self.easy_share:
            return "easy"
        return "hard" if right_share < self.hard_share else "medium"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MeasureParams:
    """The normalised symmetric geometric distance."""

    seed: Seed
    distance_points: Annotated[int, Field(ge=10, le=100_000)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class KindParams:
    """Pairs of other kinds that the confidence is tried on, and true ones: so many of each, by estimator and input."""

    seed: Seed
    estimators: Listed[str]
    inputs: Listed[Input]
    pairs: Mapping[str, Count]

    def __post_init__(self) -> None:
        _check_known("pairs", self.pairs, KINDS)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TimingParams:
    """Pairs and seeds on which time is measured."""

    pairs_per_group: Annotated[int, Field(ge=1, le=1000)]
    seeds: Listed[Seed]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GalleryParams:
    """The estimator whose rescued and lost pairs are shown, and how many."""

    estimator: str
    rescued: Annotated[int, Field(ge=1, le=100)]
    lost: Annotated[int, Field(ge=1, le=100)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ReportParams:
    """Thresholds of success, the bootstrap and what is shown; groups may be difficulties: easy, medium, hard."""

    seed: Seed
    success_px: Pixels
    strict_px: Pixels
    thresholds_px: Listed[Pixels]
    pose_deg: Listed[Annotated[float, Field(ge=0.1, le=90)]]
    distance_recall: Share
    bootstrap_draws: Annotated[int, Field(ge=100, le=1_000_000)]
    champion: str
    hard_groups: Listed[str]
    easy_groups: Listed[str]
    contact_sheet_pairs: Annotated[int, Field(ge=1, le=100)] | None
    gallery: GalleryParams | None

    def __post_init__(self) -> None:
        if self.strict_px > self.success_px:
            raise ValueError(f"strict_px = {self.strict_px}: above success_px = {self.success_px}")
        for key in ("success_px", "strict_px"):
            _check_known(key, (getattr(self, key),), self.thresholds_px)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Params:
    """The sections that both pipelines have; those of the photographs have no others."""

    evaluate: EvaluateParams
    truth: TruthParams
    measures: MeasureParams
    kinds: KindParams
    timing: TimingParams
    report: ReportParams

    def __post_init__(self) -> None:
        report, estimators = self.report, self.evaluate.estimators
        _check_known("kinds.estimators", self.kinds.estimators, estimators)
        _check_known("report.champion", (report.champion,), estimators)
        if report.gallery is not None:
            _check_known("report.gallery.estimator", (report.gallery.estimator,), estimators)
        groups = (*self.evaluate.groups, *_DIFFICULTIES)
        _check_known("report.hard_groups", report.hard_groups, groups)
        _check_known("report.easy_groups", report.easy_groups, groups)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SceneParams:
    """Rendered scenes; `pairs` counts the pairs of each family in each split."""

    seed: Seed
    families: Listed[str]
    pairs: Mapping[Split, Mapping[str, Count]]
    image_width: ImageSize
    image_height: ImageSize
    jpeg_quality: Annotated[int, Field(ge=1, le=100)]

    def __post_init__(self) -> None:
        if set(self.pairs) != set(SPLITS):
            raise ValueError(f"pairs are counted for {sorted(self.pairs)}, expected {list(SPLITS)}")
        for split, counts in self.pairs.items():
            if set(counts) != set(self.families):
                raise ValueError(f"pairs.{split} counts {sorted(counts)}, expected the families {list(self.families)}")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GroundTruthParams:
    """Control points of rendered pairs."""

    seed: Seed
    control_points: Annotated[int, Field(ge=8, le=100_000)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FeatureParams:
    """Candidate rows of the training pairs."""

    presets: Listed[Preset]
    pair_sets: Listed[str]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TrainParams:
    """Cross-validation and refit of the classifiers; `exported` is the family that each model ships, no SVM."""

    seed: Seed
    folds: Annotated[int, Field(ge=2, le=100)]
    families: Listed[Family]
    exported: Mapping[str, Family]
    max_rows_per_pair: Rows
    max_rows: Rows
    max_forest_rows: Rows
    max_svm_rows: Rows

    def __post_init__(self) -> None:
        models = ("paper", "default", "confidence")
        _check_known("exported", self.exported, models)
        for model in models:
            known = tuple(family for family in self.families if family != "svm")
            _check_known(f"exported.{model}", (self.exported.get(model),), known)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class WeightedParams:
    """Estimators that weigh matches by their probabilities, and so may profit from many improbable ones."""

    estimators: Listed[str]
    top_k: Listed[TopK | None]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HandOverParams:
    """Seeds and candidates of the choice of how matches are handed to each estimator."""

    seeds: Listed[Seed]
    max_distance_ratio: Listed[Share]
    top_k: Listed[TopK | None]
    weighted: WeightedParams
    threshold_px: Listed[Pixels]
    one_to_one: Listed[bool]
    refine: Listed[bool]
    collect: Listed[bool]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CascadeParams:
    """Seeds, candidates and tolerances of the rule by which an estimate without preprocessing is kept."""

    seeds: Listed[Seed]
    tolerance: Share
    strict_tolerance: Share
    min_confidence: Listed[Share]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ConfidenceParams:
    """What the confidence is learnt from: estimates on true pairs, by `kind_estimators` on pairs of other kinds.

    `kinds` counts the pairs of each kind per block of scenes, one of each family; `accepted_unrelated` is the share of
    estimates on unrelated pairs that reach the default of the confidence that is asked for.
    """

    seed: Seed
    estimators: Listed[str]
    kind_estimators: Listed[str]
    inputs: Listed[Input]
    kinds: Mapping[str, Count]
    accepted_unrelated: Share

    def __post_init__(self) -> None:
        _check_known("kind_estimators", self.kind_estimators, self.estimators)
        _check_known("kinds", self.kinds, KINDS[1:])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AnalysisParams:
    """What the analysis of the method's parts compares, and the named pairs of the paper's Table 1."""

    pairs_per_group: Count
    estimators: Listed[str]
    two_keypoint_counts: Listed[Annotated[int, Field(ge=2, le=1000)]]
    refined_hypotheses: Annotated[int, Field(ge=1, le=10_000)]
    table_quantiles: Listed[Share]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StudyParams(Params):
    """All sections of the study."""

    scenes: SceneParams
    ground_truth: GroundTruthParams
    features: FeatureParams
    train: TrainParams
    hand_over: HandOverParams
    confidence: ConfidenceParams
    cascade: CascadeParams
    analysis: AnalysisParams

    def __post_init__(self) -> None:
        super().__post_init__()
        estimators = self.evaluate.estimators
        _check_known("evaluate.groups", self.evaluate.groups, self.scenes.families)
        _check_known("hand_over.weighted.estimators", self.hand_over.weighted.estimators, estimators)
        _check_known("confidence.estimators", self.confidence.estimators, estimators)
        _check_known("analysis.estimators", self.analysis.estimators, estimators)


def _check_known(key: str, values: Any, known: tuple[Any, ...]) -> None:
    for value in values:
        if value not in known:
            raise ValueError(f"{key}: {value!r} is not among {', '.join(map(str, known))}")


def load_params(path: Path | str = STUDY) -> Params:
    """Read and check a parameter file: `StudyParams` where it has a section that only the study has.

    SettingsError if the file cannot be read, or a key is unknown, missing, of a wrong type or out of its range. The
    message names the file, the keys and their values.
    """
    own = StudyParams.__dataclass_fields__.keys() - Params.__dataclass_fields__.keys()
    return read_checked(path, lambda found: StudyParams if isinstance(found, dict) and own & found.keys() else Params)


def read_arguments(about: str | None, **options: Any) -> argparse.Namespace:
    """Return the command line of a stage: paths have a default, all else has to be given, of choices or any text."""
    parser = argparse.ArgumentParser(description=about)
    for name, known in options.items():
        how: dict[str, Any] = {"required": True, "choices": known}
        parser.add_argument(f"--{name}", **({"type": Path, "default": known} if isinstance(known, Path) else how))
    return parser.parse_args()


def load_study(path: Path | str = STUDY) -> StudyParams:
    """Read and check the parameters of the study, as `load_params` does."""
    return read_checked(path, lambda _: StudyParams)


def read_checked(path: Path | str, schema_of: Callable[[Any], type[Value]]) -> Value:
    """Read a file by the schema that `schema_of` names for its document; SettingsError as of `load_params`."""
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        # As JSON, since strict checks then take lists for tuples, and mappings for sections.
        return TypeAdapter(schema_of(document)).validate_json(json.dumps(document, default=str))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"{path}: cannot be read as YAML: {error}") from error
    except ValidationError as error:
        # A list that lost all its values to other errors is not too short.
        found = [part for part in error.errors() if part["type"] != "too_short" or not part["input"]]
        raise SettingsError(f"{path}: " + "; ".join(_message(part) for part in found)) from error


def _message(error: ErrorDetails) -> str:
    key = ".".join(map(str, error["loc"]))
    match error["type"]:
        case "missing":
            return f"missing key {key}"
        case "unexpected_keyword_argument":
            return f"unknown key {key}"
        case "dataclass_type":
            return f"{key or 'document'}: expected a mapping, got {error['input']!r}"
        case "value_error":  # of a section; the message begins with the key within it
            return ".".join(filter(None, (key, str(error["ctx"]["error"]))))
    return f"{key} = {error['input']!r}: {error['msg']}"
