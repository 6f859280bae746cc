"""Presets: `paper` is the paper as printed, its gaps filled plainly; `default` is the best that we measured."""

from __future__ import annotations

from dataclasses import dataclass, field

from epiprior.errors import SettingsError
from epiprior.features.detect import FeatureSettings
from epiprior.ranking.probabilities import DEFAULT_MATCH_COLUMNS, PAPER_MATCH_COLUMNS
from epiprior.ranking.two_keypoints import DEFAULT_COLUMNS, PAPER_COLUMNS


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise SettingsError(f"{name} is {value}, must lie in [{low}, {high}]")


@dataclass(frozen=True, kw_only=True)
class PreprocessSettings:
    """Every number of the method; lengths in working pixels.

    Parameters
    ----------
    name : str
        Of the preset, and of the model that belongs to it.
    features : FeatureSettings
        Section 4.1.
    max_distance_ratio : float
        X_L keeps matches up to this d_r (section 4.1).
    roll_bandwidth_deg : float
        Width of the kernel of the roll's density, degrees (section 4.2).
    merge_rolls_deg : float
        One roll hypothesis, 0, where alpha_exp is within this many degrees of it; 0: always both (section 4.2).
    min_cluster_similarity : float
        Clusters stop merging below this similarity (section 4.2).
    max_matches_per_cluster_pair : int
        Ours; see `putative_matches` (section 4.3).
    nearest, within, nearest_of_cluster : int, float, int
        K_1, K_2 and K_3 (section 4.4).
    max_within : int
        Ours; see `neighbourhoods` (section 4.4).
    two_keypoint_count : int
        K_2kp (section 4.4).
    frame, frame_radius : str, float
        Of the rough fundamental matrices; see `frame_points` (section 4.5).
    vote_threshold : float
        Sampson distance below which a match supports a matrix, working pixels (section 4.5).
    two_keypoint_columns, match_columns : tuple of str
        Of 2kpmd and kpmd (sections 4.4 and 4.6).
    """

    name: str
    features: FeatureSettings = field(default_factory=FeatureSettings)
    max_distance_ratio: float = 0.95
    roll_bandwidth_deg: float = 7.0
    merge_rolls_deg: float = 5.0
    min_cluster_similarity: float = 0.85
    max_matches_per_cluster_pair: int = 400
    nearest: int = 5
    within: float = 5.0
    nearest_of_cluster: int = 1
    max_within: int = 40
    two_keypoint_count: int = 100
    frame: str = "2keypoint"
    frame_radius: float = 6.0
    vote_threshold: float = 3.0
    two_keypoint_columns: tuple[str, ...] = DEFAULT_COLUMNS
    match_columns: tuple[str, ...] = DEFAULT_MATCH_COLUMNS

    def __post_init__(self) -> None:
        _check("max_distance_ratio", self.max_distance_ratio, 0.0, 1.0)
        _check("roll_bandwidth_deg", self.roll_bandwidth_deg, 0.5, 90.0)
        _check("merge_rolls_deg", self.merge_rolls_deg, 0.0, 180.0)
        _check("min_cluster_similarity", self.min_cluster_similarity, -1.0, 1.0)
        _check("max_matches_per_cluster_pair", self.max_matches_per_cluster_pair, 1, 1_000_000)
        _check("nearest", self.nearest, 0, 1000)
        _check("within", self.within, 0.0, 1000.0)
        _check("nearest_of_cluster", self.nearest_of_cluster, 0, 100)
        _check("max_within", self.max_within, 0, 1000)
        _check("two_keypoint_count", self.two_keypoint_count, 2, 1000)
        _check("frame_radius", self.frame_radius, 0.1, 100.0)
        _check("vote_threshold", self.vote_threshold, 0.01, 100.0)
        if self.frame not in ("feature", "2keypoint"):
            raise SettingsError(f"frame is {self.frame!r}, known: 'feature', '2keypoint'")

    @property
    def extended(self) -> bool:
        """Whether 2kpmd has columns that the paper does not have."""
        return self.two_keypoint_columns != PAPER_COLUMNS


PAPER = PreprocessSettings(
    name="paper",
    features=FeatureSettings(root=False),
    max_distance_ratio=0.9,
    merge_rolls_deg=0.0,
    frame="feature",
    two_keypoint_columns=PAPER_COLUMNS,
    match_columns=PAPER_MATCH_COLUMNS,
)
DEFAULT = PreprocessSettings(name="default")
PRESETS = {preset.name: preset for preset in (PAPER, DEFAULT)}


def find_preset(name: str) -> PreprocessSettings:
    """Return the preset of that name.

    Raises
    ------
    SettingsError
        If there is none; the message lists those there are.
    """
    if name not in PRESETS:
        raise SettingsError(f"preset is {name!r}, known: {', '.join(PRESETS)}")
    return PRESETS[name]
