"""Step 3a: the relative roll of the two cameras, from the orientations of standard matches (paper, section 4.2)."""

import numpy as np

from epiprior.types import FloatArray

_GRID = 720


def orientation_differences(orientation1_deg: FloatArray, orientation2_deg: FloatArray) -> FloatArray:
    """Return orientation 2 minus orientation 1, degrees in [0, 360): the roll of image 2 by each match alone."""
    return np.asarray(np.mod(orientation2_deg - orientation1_deg, 360.0))


def roll_density(differences_deg: FloatArray, bandwidth_deg: float = 7.0) -> tuple[FloatArray, FloatArray]:
    """Return 720 angles in degrees, half a degree apart, and the circular kernel density of the differences there.

    The von Mises kernel has a concentration of one over the squared `bandwidth_deg` in radians. The density is per
    degree, integrates to 1 over the circle, and is uniform without any match.
    """
    angles = np.arange(_GRID, dtype=np.float64) * (360.0 / _GRID)
    if not len(differences_deg):
        return angles, np.full(_GRID, 1 / 360.0)
    histogram = np.bincount(np.rint(differences_deg * (_GRID / 360.0)).astype(np.int64) % _GRID, minlength=_GRID)
    kernel = np.exp((np.cos(np.deg2rad(angles)) - 1) / np.deg2rad(bandwidth_deg) ** 2)
    density: FloatArray = np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), _GRID)
    return angles, density / (density.sum() * 360.0 / _GRID)


def expected_roll(differences_deg: FloatArray, bandwidth_deg: float = 7.0) -> float:
    """Return alpha_exp, the highest peak of `roll_density`, degrees in (-180, 180]; 0 without any match."""
    if not len(differences_deg):
        return 0.0
    angles, density = roll_density(differences_deg, bandwidth_deg)
    # Rounding keeps the choice between equal peaks independent of the last bits of the transform.
    peak = float(angles[np.round(density, 12).argmax()])
    return peak if peak <= 180.0 else peak - 360.0
