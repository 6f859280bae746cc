"""Settings of the method, and the presets: `paper`, the paper as printed, `default`, and two more for speed or reach.

A preset names its model (``models/<model>``) and the input of estimators that it ranks. Columns of the descriptors
2kpmd and kpmd are settings too: a model is trained on those of the preset that has its name.
"""

import math
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Literal

from epiprior.errors import SettingsError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Mode = Literal["cascade", "preprocess", "standard"]

DETECTORS = ("sift", "colmap-sift")
FRAMES = ("feature", "2keypoint")

COHERENCE_COLUMNS = ("coherence_near", "coherence_near_share", "coherence_far", "coherence_far_share")
PAPER_TWO_KEYPOINT_COLUMNS = (
    "two_keypoint_matches1", "two_keypoint_matches2", "distance_ratio", "angle_difference", "same_cluster",
    "min_distance",
)  # fmt: skip
TWO_KEYPOINT_COLUMNS = (
    *PAPER_TWO_KEYPOINT_COLUMNS, "scale_change_difference", "turn_difference",
    *(f"{name}_{match}" for name in ("similarity", "fixed_similarity", "candidates", "roll_error")
      for match in ("main", "neighbour")),
    "scale_change_main", *(f"{name}_{match}" for match in ("main", "neighbour") for name in COHERENCE_COLUMNS),
)  # fmt: skip
PAPER_MATCH_COLUMNS = ("supporting_matrices", "distance_ratio", "similarity_weight")
MATCH_COLUMNS = (
    *PAPER_MATCH_COLUMNS, "mutual", "distance_ratio_backward", "similarity", "fixed_similarity", "best_two_keypoint",
    "summed_two_keypoint", "relative_support", "weighted_support", "rival_support", "rivals", "roll_error",
    "scale_change", *COHERENCE_COLUMNS, "pair_best_two_keypoints", "pair_two_keypoints", "pair_support",
)  # fmt: skip
SECOND_ROUND_COLUMNS = (
    *MATCH_COLUMNS, "probability", "rank", "best_rival1", "best_rival2",
    *(f"probable_{name}{side}" for side in "12" for name in COHERENCE_COLUMNS), "distance_best", "distance_second",
    "distance_third", "refined_votes", "evidence_without", "pair_probability", "pair_top_probability",
    "pair_evidence", "pair_second_evidence",
)  # fmt: skip


def in_range(low: float, high: float, default: Any) -> Any:
    """Return a field of settings with a default and the range that `check_settings` asks for."""
    return field(default=default, metadata={"range": (low, high)})


def check_settings(settings: "DataclassInstance") -> None:
    """Raise SettingsError for a number out of the range of its field, or a value where true or false is expected.

    None is in range where it is the default.
    """
    for item in fields(settings):
        value = getattr(settings, item.name)
        if "range" in item.metadata and not (value is None and item.default is None):
            check_number(item.name, value, *item.metadata["range"])
        elif isinstance(item.default, bool) and not isinstance(value, bool):
            raise SettingsError(f"{item.name} is {value!r}, expected true or false")


def check_number(name: str, value: object, low: float, high: float) -> None:
    """Raise SettingsError unless `value` is a number in [low, high], a whole one where `low` is one."""
    kind = Integral if isinstance(low, int) else Real
    if isinstance(value, bool) or not isinstance(value, kind) or not low <= float(value) <= high:
        what = "whole number" if kind is Integral else "number"
        raise SettingsError(f"{name} is {value!r}, must be a {what} in [{low:g}, {high:g}]")


def check_choice(name: str, value: str, known: tuple[str, ...]) -> None:
    """Raise SettingsError unless a value is among the known ones."""
    if value not in known:
        raise SettingsError(f"{name} is {value!r}, known: {', '.join(known)}")


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """How features are found and described (section 4.1).

    Parameters
    ----------
    detector : ``sift`` (OpenCV) or ``colmap-sift`` (VLFeat's, through pycolmap).
    max_image_size : Longer side at which the image is worked on, pixels, >= 64.
    max_keypoints : Number of strongest features kept, >= 8.
    contrast_threshold : Least contrast of a feature as OpenCV counts it, in [0, 1]: three times the peak threshold of
        VLFeat's and COLMAP's SIFT. OpenCV's own 0.04 leaves half of the features of a dull photograph.
    min_scale : Least sigma, working pixels, >= 0. 2.0 leaves out the doubled image, as VLFeat does by default.
    root : RootSIFT (Arandjelovic and Zisserman, 2012): the square root of the L1-normalised descriptor.
    centred : Subtract the descriptor's mean, so that the inner product is the normalised cross-correlation.
    """

    detector: str = "sift"
    max_image_size: int = in_range(64, math.inf, 1024)
    max_keypoints: int = in_range(8, math.inf, 8000)
    contrast_threshold: float = in_range(0.0, 1.0, 0.013)
    min_scale: float = in_range(0.0, 1000.0, 0.0)
    root: bool = True
    centred: bool = True

    def __post_init__(self) -> None:
        check_choice("detector", self.detector, DETECTORS)
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class PreprocessSettings:
    """Every number of the method; lengths in working pixels.

    Parameters
    ----------
    name : Of the preset.
    model : Name of the model and of the hand-overs that it uses.
    features : Section 4.1.
    max_distance_ratio : X_L keeps matches up to this d_r (section 4.1).
    roll_bandwidth_deg : Width of the kernel of the roll's density, degrees (section 4.2).
    merge_rolls_deg : One roll hypothesis, 0, where alpha_exp is within so many degrees; 0: always both (section 4.2).
    min_cluster_similarity : Clusters stop merging below this similarity (section 4.2).
    max_matches_per_cluster_pair : Ours; see `putative_matches` (section 4.3).
    nearest, within, nearest_of_cluster : K_1, K_2 and K_3 (section 4.4).
    max_within : Ours; see `neighbourhoods` (section 4.4).
    two_keypoint_count : K_2kp (section 4.4).
    frame, frame_radius : Of the rough fundamental matrices; see `frame_points` (section 4.5).
    vote_threshold : Sampson distance below which a match supports a matrix, working pixels (section 4.5).
    two_keypoint_columns, match_columns : Of 2kpmd and kpmd (sections 4.4 and 4.6).
    second_round : So many of the most probable matches are judged again; 0: none (ours; `second_round`).
    """

    name: str
    model: str = "default"
    features: FeatureSettings = field(default_factory=FeatureSettings)
    max_distance_ratio: float = in_range(0.0, 1.0, 0.95)
    roll_bandwidth_deg: float = in_range(0.5, 90.0, 7.0)
    merge_rolls_deg: float = in_range(0.0, 180.0, 5.0)
    min_cluster_similarity: float = in_range(-1.0, 1.0, 0.85)
    max_matches_per_cluster_pair: int = in_range(1, 1_000_000, 400)
    nearest: int = in_range(0, 1000, 5)
    within: float = in_range(0.0, 1000.0, 5.0)
    nearest_of_cluster: int = in_range(0, 100, 1)
    max_within: int = in_range(0, 1000, 40)
    two_keypoint_count: int = in_range(2, 1000, 100)
    frame: str = "2keypoint"
    frame_radius: float = in_range(0.1, 100.0, 6.0)
    vote_threshold: float = in_range(0.01, 100.0, 3.0)
    two_keypoint_columns: tuple[str, ...] = TWO_KEYPOINT_COLUMNS
    match_columns: tuple[str, ...] = MATCH_COLUMNS
    second_round: int = in_range(0, 1_000_000, 3000)

    def __post_init__(self) -> None:
        check_choice("frame", self.frame, FRAMES)
        check_settings(self)

    @property
    def extended(self) -> bool:
        """Whether 2kpmd has columns that the paper does not have."""
        return self.two_keypoint_columns != PAPER_TWO_KEYPOINT_COLUMNS


PAPER = PreprocessSettings(
    name="paper",
    model="paper",
    features=FeatureSettings(contrast_threshold=0.0, min_scale=2.0, root=False),  # VLFeat's defaults
    max_distance_ratio=0.9,
    merge_rolls_deg=0.0,
    frame="feature",
    two_keypoint_columns=PAPER_TWO_KEYPOINT_COLUMNS,
    match_columns=PAPER_MATCH_COLUMNS,
    second_round=0,
)
DEFAULT = PreprocessSettings(name="default")
FAST = PreprocessSettings(name="fast", features=FeatureSettings(max_keypoints=4000))
THOROUGH = PreprocessSettings(
    name="thorough", features=FeatureSettings(max_image_size=1600, max_keypoints=16_000, contrast_threshold=0.005)
)
PRESETS = {preset.name: preset for preset in (PAPER, FAST, DEFAULT, THOROUGH)}


def find_preset(name: str) -> PreprocessSettings:
    """Return the preset of that name, or raise SettingsError with the names there are."""
    check_choice("preset", name, tuple(PRESETS))
    return PRESETS[name]
