"""Hypotheses of the estimator ``epiprior``: from two oriented matches, and from samples of the ranking.

Both are deterministic: the pairs of the best matches are taken in order, and the samples are drawn by a generator of
fixed state.
"""

from __future__ import annotations

import numba
import numpy as np

from epiprior.kernels.epiprior_kernels import fit_weighted
from epiprior.types import FloatArray, IntArray, MatchSet

FRAME_RADIUS = 6.0
SAMPLE_SIZE = 8
_STATE = 20140


@numba.njit(cache=True, nogil=True)
def fit_samples(x1, x2, rows):  # type: ignore[no-untyped-def]
    """Return the eight-point F of each row of `rows` (S, K) into the points; zero where they decide nothing."""
    models = np.zeros((len(rows), 3, 3))
    size = rows.shape[1]
    y1, y2, ones = np.empty((size, 2)), np.empty((size, 2)), np.ones(size)
    for s in range(len(rows)):
        for k in range(size):
            y1[k, 0], y1[k, 1] = x1[rows[s, k], 0], x1[rows[s, k], 1]
            y2[k, 0], y2[k, 1] = x2[rows[s, k], 0], x2[rows[s, k], 1]
        fit_weighted(y1, y2, ones, models[s])
    return models


def oriented_pairs(matches: MatchSet, count: int, min_distance_px: float) -> FloatArray:
    """Return an F for every two of the best `count` matches that lie far enough apart in both images.

    Parameters
    ----------
    matches : MatchSet
        N matches, best first, one-to-one.
    count : int
        So many of them take part.
    min_distance_px : float
        Two matches nearer to each other say too little of F.

    Returns
    -------
    ndarray, shape (P, 3, 3), float64
        Eight-point estimates from each match and three points around it, by the scale and orientation of its features.

    References
    ----------
    BEEM-style, our interpretation of Goshen and Shimshoni, TPAMI 2008: three points at angles 120 degrees apart, six
    sigma away.
    """
    head = matches.take(slice(count))
    i, j = np.triu_indices(len(head), 1)
    far = np.ones(len(i), np.bool_)
    for x in (head.x1, head.x2):
        far &= np.linalg.norm(x[i] - x[j], axis=1) >= min_distance_px
    corners = 4 * np.column_stack([np.repeat(i[far, None], 4, axis=1), np.repeat(j[far, None], 4, axis=1)])
    rows = corners + np.tile(np.arange(4), 2)
    y1 = _with_frame(head.x1, head.scale1, head.orientation1_deg)
    y2 = _with_frame(head.x2, head.scale2, head.orientation2_deg)
    return np.asarray(fit_samples(y1, y2, rows))


def _with_frame(x: FloatArray, scale: FloatArray, orientation_deg: FloatArray) -> FloatArray:
    """Return each point and three around it, (4 N, 2)."""
    angle = np.deg2rad(orientation_deg)[:, None] + 2 * np.pi * np.arange(3) / 3
    offsets = (FRAME_RADIUS * scale)[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.concatenate([x[:, None], x[:, None] + offsets], axis=1).reshape(-1, 2)


def progressive_rows(matches: int, samples: int) -> IntArray:
    """Return samples of eight different matches from heads of the ranking that grow from the best to all.

    Parameters
    ----------
    matches : int
        How many there are, >= 8.
    samples : int
        How many samples.

    Returns
    -------
    ndarray, shape (samples, 8), int64
        Of the first samples all rows are among the best matches, of the last anywhere; the head grows by the same
        factor from sample to sample (the schedule of PROSAC in its spirit; ours in its pace).
    """
    rng = np.random.default_rng(_STATE)
    head = np.geomspace(min(2 * SAMPLE_SIZE, matches), matches, samples).astype(np.int64)
    rows = np.empty((samples, SAMPLE_SIZE), np.int64)
    draws = rng.random((samples, SAMPLE_SIZE))
    for k in range(SAMPLE_SIZE):
        # The k-th draw among the rows that are left: skip those drawn before, in increasing order.
        row = (draws[:, k] * (head - k)).astype(np.int64)
        for earlier in np.sort(rows[:, :k], axis=1).T:
            row += row >= earlier
        rows[:, k] = row
    return rows
