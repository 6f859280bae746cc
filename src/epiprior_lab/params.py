"""The parameters of the study: strict dataclasses over ``params.yaml``.

Every key must be there, of its type and in its range. There are no defaults here: the file says everything.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import yaml

from epiprior.errors import SettingsError
from epiprior_lab.sections import Range, Section, build_section

Split = Literal["train", "validation", "test"]
Preset = Literal["paper", "default"]
Input = Literal["standard", "snn", "generalized", "paper", "default"]

Seed = Annotated[int, Range(0, 2**31 - 1)]
Probability = Annotated[float, Range(0, 1)]
Pixels = Annotated[float, Range(0.01, 1000)]
PairCount = Annotated[int, Range(1, 100_000)]
Rows = Annotated[int, Range(100, 10**8)]
TopK = Annotated[int, Range(8, 1_000_000)]

_WITHOUT = frozenset({"standard", "generalized"})  # what an estimator gets without the preprocessing step


@dataclass(frozen=True, kw_only=True)
class PairCounts(Section):
    """Pairs of each family in each split."""

    train: Mapping[str, PairCount]
    validation: Mapping[str, PairCount]
    test: Mapping[str, PairCount]


@dataclass(frozen=True, kw_only=True)
class SceneParams(Section):
    """Rendered scenes."""

    seed: Seed
    families: tuple[str, ...]
    pairs: PairCounts
    image_width: Annotated[int, Range(64, 8192)]
    image_height: Annotated[int, Range(64, 8192)]
    jpeg_quality: Annotated[int, Range(1, 100)]

    def __post_init__(self) -> None:
        super().__post_init__()
        for split in ("train", "validation", "test"):
            counts = getattr(self.pairs, split)
            if set(counts) != set(self.families):
                raise SettingsError(
                    f"pairs.{split} counts {sorted(counts)}, expected the families {list(self.families)}"
                )


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
class WeightedParams(Section):
    """Estimators that weigh matches by their probabilities, and so may profit from many improbable ones."""

    estimators: tuple[str, ...]
    top_k: tuple[TopK | None, ...]


@dataclass(frozen=True, kw_only=True)
class HandOverParams(Section):
    """Seeds and candidates of the choice of how matches are handed to each estimator."""

    seeds: tuple[Seed, ...]
    max_distance_ratio: tuple[Probability, ...]
    top_k: tuple[TopK | None, ...]
    weighted: WeightedParams
    threshold_px: tuple[Pixels, ...]
    one_to_one: tuple[bool, ...]
    refine: tuple[bool, ...]
    collect: tuple[bool, ...]

    def top_k_for(self, estimator: str) -> tuple[int | None, ...]:
        """Return the numbers of matches that are tried for an estimator."""
        return self.weighted.top_k if estimator in self.weighted.estimators else self.top_k


@dataclass(frozen=True, kw_only=True)
class EvaluateParams(Section):
    """Estimators, inputs and repetitions of the evaluation."""

    seeds: tuple[Seed, ...]
    estimators: tuple[str, ...]
    inputs: tuple[Input, ...]
    other_inputs: Mapping[str, tuple[Input, ...]]

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = [name for name in self.other_inputs if name not in self.estimators]
        if unknown:
            raise SettingsError(f"other_inputs.{unknown[0]}: not among estimators {list(self.estimators)}")
        for name, inputs in self.inputs_by_estimator.items():
            if len(_WITHOUT.intersection(inputs)) != 1:
                raise SettingsError(f"inputs of {name} are {', '.join(inputs)}: expected standard or generalized")

    @property
    def inputs_by_estimator(self) -> dict[str, tuple[str, ...]]:
        """The inputs that each estimator gets, in the order of `estimators`."""
        return {name: self.other_inputs.get(name, self.inputs) for name in self.estimators}

    @property
    def all_inputs(self) -> tuple[str, ...]:
        """All inputs that some estimator gets."""
        return tuple(dict.fromkeys(i for inputs in self.inputs_by_estimator.values() for i in inputs))


@dataclass(frozen=True, kw_only=True)
class CascadeParams(Section):
    """Seeds, candidates and tolerances of the rule by which an estimate without preprocessing is kept."""

    seeds: tuple[Seed, ...]
    tolerance: Probability
    strict_tolerance: Probability
    min_spread: tuple[Annotated[int, Range(0, 1_000_000)], ...]
    min_plausibility: tuple[Probability, ...]


@dataclass(frozen=True, kw_only=True)
class AnalysisParams(Section):
    """What the analysis of the method's parts compares, and the named pairs of the paper's Table 1."""

    pairs_per_family: Annotated[int, Range(1, 100_000)]
    estimators: tuple[str, ...]
    two_keypoint_counts: tuple[Annotated[int, Range(2, 1000)], ...]
    refined_hypotheses: Annotated[int, Range(1, 10_000)]
    table_quantiles: tuple[Probability, ...]


@dataclass(frozen=True, kw_only=True)
class OverheadParams(Section):
    """Pairs and seeds on which time is measured."""

    pairs_per_family: Annotated[int, Range(1, 1000)]
    seeds: tuple[Seed, ...]


@dataclass(frozen=True, kw_only=True)
class BoundParams(Section):
    """What the study wants to reach; the report says what it did reach."""

    hard_families: tuple[str, ...]
    easy_families: tuple[str, ...]
    contribution: Mapping[str, Annotated[float, Range(0, 100)]]
    easy_loss: Probability
    champion: str


@dataclass(frozen=True, kw_only=True)
class ReportParams(Section):
    """Thresholds of success, the bootstrap, and bounds."""

    seed: Seed
    success_px: Pixels
    strict_px: Pixels
    bootstrap_draws: Annotated[int, Range(100, 1_000_000)]
    contact_sheet_pairs: Annotated[int, Range(1, 100)]
    bounds: BoundParams

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
    cascade: CascadeParams
    analysis: AnalysisParams
    overhead: OverheadParams
    report: ReportParams

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds, families, estimators = self.report.bounds, self.scenes.families, self.evaluate.estimators
        for key, names, known in (
            ("hand_over.weighted.estimators", self.hand_over.weighted.estimators, estimators),
            ("report.bounds.hard_families", bounds.hard_families, families),
            ("report.bounds.easy_families", bounds.easy_families, families),
            ("report.bounds.contribution", tuple(bounds.contribution), estimators),
            ("report.bounds.champion", (bounds.champion,), estimators),
            ("analysis.estimators", self.analysis.estimators, estimators),
        ):
            unknown = [name for name in names if name not in known]
            if unknown:
                raise SettingsError(f"{key}: {unknown[0]!r} is not among {', '.join(known)}")


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
        return build_section(Params, document, "")
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error
