"""The four families of scenes, after the data sets of the paper: ZuBuD2; ZuBuD1 and Urban; Open; BLOGS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from epiprior.errors import SettingsError

Bounds = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class FamilySettings:
    """How scenes of a family look and how they are photographed. All bounds are (low, high).

    Parameters
    ----------
    facades : float
        Share of the scenes that are streets; the others are open places. In [0, 1].
    distinct : tuple of float
        How far one place of a wall differs from the others, in [0, 1].
    variety : tuple of float
        How far one window differs from the next, in [0, 1].
    angle_deg : tuple of float
        Median angle between the rays of both cameras, degrees.
    overlap : tuple of float
        Part of what either image sees that the other sees too, in [0, 1].
    scale_ratio : tuple of float
        Ratio of the distances of both cameras, >= 1.
    roll_deg : tuple of float
        Rotation of the second camera about its axis, either way, degrees.
    relief : float
        Least part of what both images see that lies off the front's plane, in [0, 1]: on one plane no F is
        decided.
    passing : tuple of float
        Things that stand in one image only, for each image.
    relit : float
        Share of the pairs whose second image is taken under another sun, in [0, 1].
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

    def __post_init__(self) -> None:
        for name in ("facades", "relief", "relit"):
            if not 0 <= getattr(self, name) <= 1:
                raise SettingsError(f"{name} = {getattr(self, name)}, expected a number in [0, 1]")
        limits = {"distinct": (0, 1), "variety": (0, 1), "angle_deg": (0, 90), "overlap": (0, 1), "scale_ratio": (1, 8),
                  "roll_deg": (0, 180), "passing": (0, 20)}  # fmt: skip
        for field in fields(self):
            if field.name in limits:
                low, high = getattr(self, field.name)
                least, most = limits[field.name]
                if not least <= low <= high <= most:
                    raise SettingsError(f"{field.name} = ({low}, {high}), expected {least} <= low <= high <= {most}")


FAMILIES: Mapping[str, FamilySettings] = MappingProxyType(
    {
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
    }
)  # fmt: skip
"""Settings by family name."""
