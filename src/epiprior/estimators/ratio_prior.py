"""A prior from the distance ratio alone: the mixture of inlier and outlier densities of BEEM (BEEM-style).

The densities of d_r of right and of wrong nearest neighbours were learnt from rendered training scenes by kernel
density estimation; the share of right matches is fitted per pair to the pair's own ratios. That BEEM (Goshen and
Shimshoni, TPAMI 2008) does this is from memory.
"""

import numpy as np

from epiprior.types import FloatArray, MatchSet

BANDWIDTH = 0.03
_GRID = np.linspace(0.0, 1.0, 26)
_STEPS = 50
_LIMITS = (0.01, 0.99)
_FLOOR = 1e-4

# By `python -m epiprior_lab.training.ratio_densities` from the training scenes of the study: plain SIFT, all nearest
# neighbours.
DENSITY_IN = np.array([
    2.4e-05, 0.0004, 0.004, 0.018, 0.059, 0.154, 0.270, 0.388, 0.514,
    0.621, 0.758, 0.895, 0.949, 1.031, 1.160, 1.275, 1.336, 1.409,
    1.554, 1.683, 1.758, 1.795, 1.858, 2.077, 2.262, 2.341,
])  # fmt: skip
DENSITY_OUT = np.array([
    3.7e-13, 3.9e-10, 1.4e-07, 9.4e-06, 0.00013, 0.00049, 0.0011, 0.0023, 0.0046,
    0.0078, 0.012, 0.017, 0.026, 0.039, 0.057, 0.084, 0.124, 0.191,
    0.297, 0.476, 0.797, 1.388, 2.528, 4.759, 8.585, 11.206,
])  # fmt: skip


def density(ratios: FloatArray, bandwidth: float = BANDWIDTH) -> FloatArray:
    """Return the density of ratios in [0, 1], N >= 1, on the grid of 26 values from 0 to 1.

    `bandwidth` is the standard deviation of the Gaussian kernel; mass that leaves [0, 1] is reflected.
    """
    d = np.asarray(ratios, dtype=np.float64)
    total = np.zeros(len(_GRID))
    for mirrored in (d, -d, 2.0 - d):
        z = (_GRID[:, None] - mirrored[None, :]) / bandwidth
        total += np.exp(-0.5 * z * z).sum(axis=1)
    return np.asarray(total / (len(d) * bandwidth * np.sqrt(2 * np.pi)))


def inlier_probability(distance_ratio: FloatArray) -> FloatArray:
    """Return the probability that each match is right, given the distance ratios d_r of its pair of images, (N,).

    ``m f_in / (m f_in + (1 - m) f_out)``, with the m in [0.01, 0.99] that expectation maximisation finds in at most 50
    steps. Ratios lie in [0, 1], 1 where missing, and are often cut: both densities are normalised up to the highest.
    """
    ratio = np.clip(np.asarray(distance_ratio, dtype=np.float64), 0.0, 1.0)
    if not len(ratio):
        return np.empty(0)
    cut = float(ratio.max())
    f_in, f_out = (
        np.maximum(np.interp(ratio, _GRID, table), _FLOOR) / max(_mass(table, cut), _FLOOR)
        for table in (DENSITY_IN, DENSITY_OUT)
    )
    m = 0.5
    for _ in range(_STEPS):
        posterior = m * f_in / (m * f_in + (1 - m) * f_out)
        new = float(np.clip(posterior.mean(), *_LIMITS))
        if abs(new - m) < 1e-6:
            break
        m = new
    return np.asarray(m * f_in / (m * f_in + (1 - m) * f_out))


def _mass(table: FloatArray, cut: float) -> float:
    """Return the integral of a tabulated density from 0 to `cut`."""
    at = np.append(_GRID[cut > _GRID], cut)
    return float(np.trapezoid(np.interp(at, _GRID, table), at))


def probability_or_ratio_prior(matches: MatchSet) -> FloatArray:
    """Return the matches' probabilities, or where they carry none, `inlier_probability` of their distance ratios."""
    if np.isnan(matches.probability).any():
        return inlier_probability(matches.distance_ratio)
    return matches.probability
