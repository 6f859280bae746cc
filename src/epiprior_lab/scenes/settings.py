"""The four families of scenes, after the data sets of the paper: ZuBuD2; ZuBuD1 and Urban; Open; BLOGS."""

from collections.abc import Mapping
from dataclasses import dataclass

Bounds = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class FamilySettings:
    """How scenes of a family look and how they are photographed. All bounds are (low, high).

    `facades` is the share of the scenes that are streets, the others are open places; `relit` that of the pairs whose
    second image is taken under another sun. `distinct` and `variety` tell how far one place of a wall differs from the
    others, and one window from the next, in [0, 1]. `angle_deg` is the median angle between the rays of both cameras,
    `overlap` the part of what either image sees that the other sees too, `scale_ratio` that of the distances of both
    cameras, `roll_deg` the rotation of the second camera about its axis, either way. `relief` is the least part of
    what both images see that lies off the front's plane: on one plane no F is decided. `passing` is the number of
    things that stand in one image only, for each image.
    """

    facades: float
    distinct: Bounds
    variety: Bounds
    angle_deg: Bounds
    overlap: Bounds
    scale_ratio: Bounds
    roll_deg: Bounds
    relief: float
    passing: Bounds
    relit: float


FAMILIES: Mapping[str, FamilySettings] = {
    "facades-easy": FamilySettings(
        facades=1.0, distinct=(0.5, 1.0), variety=(0.5, 1.0), angle_deg=(6, 20), overlap=(0.5, 1.0),
        scale_ratio=(1.0, 1.25), roll_deg=(0, 3), relief=0.3, passing=(0, 1), relit=0.0,
    ),
    "facades-hard": FamilySettings(
        facades=1.0, distinct=(0.0, 0.2), variety=(0.1, 0.4), angle_deg=(46, 68), overlap=(0.16, 0.48),
        scale_ratio=(1.0, 2.4), roll_deg=(0, 5), relief=0.15, passing=(2, 5), relit=0.6,
    ),
    "open": FamilySettings(
        facades=0.0, distinct=(0.1, 0.5), variety=(0.3, 1.0), angle_deg=(38, 65), overlap=(0.12, 0.4),
        scale_ratio=(1.0, 2.5), roll_deg=(0, 6), relief=0.15, passing=(1, 4), relit=0.5,
    ),
    "rolled": FamilySettings(
        facades=0.5, distinct=(0.2, 0.7), variety=(0.3, 1.0), angle_deg=(18, 48), overlap=(0.25, 0.8),
        scale_ratio=(1.0, 2.2), roll_deg=(20, 180), relief=0.15, passing=(1, 5), relit=0.0,
    ),
}  # fmt: skip
"""Settings by family name."""
