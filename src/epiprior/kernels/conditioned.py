"""Matches in the coordinates that the compiled parts work in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from epiprior.types import FloatArray, MatchSet


@dataclass(frozen=True, kw_only=True)
class Conditioned:
    """Matches as the compiled parts want them.

    Parameters
    ----------
    columns : ndarray, shape (4, N), float64
        x and y in image 1, x and y in image 2, centred and divided by `unit_px`.
    frames : ndarray, shape (4, N), float64
        Scale in image 1 and 2 in units, orientation in image 1 and 2 in radians.
    centre1, centre2 : ndarray, shape (2,), float64
        What was subtracted, pixels.
    unit_px : float
        Pixels per unit, the same for both images.
    """

    columns: FloatArray
    frames: FloatArray
    centre1: FloatArray
    centre2: FloatArray
    unit_px: float

    def to_pixels(self, F: FloatArray) -> FloatArray:
        """Return F of conditioned coordinates as an F of pixels."""
        T1, T2 = (np.array([[1, 0, -c[0]], [0, 1, -c[1]], [0, 0, self.unit_px]]) for c in (self.centre1, self.centre2))
        pixels: FloatArray = T2.T @ F @ T1
        return pixels


def condition(matches: MatchSet) -> Conditioned:
    """Centre the matches in both images and divide by one length, the mean spread of both, for the solvers."""
    c1, c2 = matches.x1.mean(axis=0), matches.x2.mean(axis=0)
    spread = ((matches.x1 - c1) ** 2).sum(axis=1).mean() + ((matches.x2 - c2) ** 2).sum(axis=1).mean()
    unit = max(math.sqrt(float(spread) / 4.0), 1e-9)
    columns = np.ascontiguousarray(np.column_stack([matches.x1 - c1, matches.x2 - c2]).T / unit)
    frames = np.stack(
        [
            matches.scale1 / unit,
            matches.scale2 / unit,
            np.deg2rad(matches.orientation1_deg),
            np.deg2rad(matches.orientation2_deg),
        ]
    )
    return Conditioned(columns=columns, frames=frames, centre1=c1, centre2=c2, unit_px=unit)
