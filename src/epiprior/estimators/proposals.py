"""Hypotheses of the estimator ``epiprior``: two oriented matches, samples of the ranking, plane and parallax.

All are deterministic: pairs of matches are taken in order, samples are drawn by a generator of fixed state.
"""

import numpy as np

from epiprior.geometry import as_columns, sampson_distance, with_three_around
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.solvers import fit_samples
from epiprior.types import FloatArray, IntArray, MatchSet
from epiprior.verification.degeneracy import fit_homography, homography_distance

FRAME_RADIUS = 6.0
SAMPLE_SIZE = 8
_STATE = 20140
_CHUNK = 512


def oriented_pairs(matches: MatchSet, count: int, min_distance_px: float) -> FloatArray:
    """Return an F, shape (P, 3, 3), for every two of the best `count` matches that lie far enough apart in both images.

    Matches are one-to-one. Eight-point estimates from each match and three points around it, by the scale and
    orientation of its features. BEEM-style, our interpretation of Goshen and Shimshoni, TPAMI 2008: three points at
    angles 120 degrees apart, six sigma away.
    """
    head = matches.take(slice(count))
    i, j = np.triu_indices(len(head), 1)
    far = np.all([np.linalg.norm(x[i] - x[j], axis=1) >= min_distance_px for x in (head.x1, head.x2)], axis=0)
    corners = 4 * np.column_stack([np.repeat(i[far, None], 4, axis=1), np.repeat(j[far, None], 4, axis=1)])
    rows = corners + np.tile(np.arange(4), 2)
    y1 = with_three_around(head.x1, FRAME_RADIUS * head.scale1, np.deg2rad(head.orientation1_deg))
    y2 = with_three_around(head.x2, FRAME_RADIUS * head.scale2, np.deg2rad(head.orientation2_deg))
    return fit_all(as_columns(y1.reshape(-1, 2), y2.reshape(-1, 2)), rows)


def fit_all(columns: FloatArray, rows: IntArray) -> FloatArray:
    """Return the eight-point F of each row of `rows` (S, K) into the matches (4, N): shape (S, 3, 3)."""
    models = np.empty((len(rows), 3, 3))

    def work(part: slice) -> None:
        models[part] = fit_samples(columns, rows[part])

    in_chunks(work, len(rows), _CHUNK)
    return models


def progressive_rows(matches: int, samples: int) -> IntArray:
    """Return samples of eight matches, (samples, 8), from heads of the ranking that grow from the best to all.

    The head grows by the same factor from sample to sample (after the schedule of PROSAC, at a pace of our own).
    """
    head = np.geomspace(min(2 * SAMPLE_SIZE, matches), matches, samples).astype(np.int64)
    rows = np.empty((samples, SAMPLE_SIZE), np.int64)
    draws = np.random.default_rng(_STATE).random((samples, SAMPLE_SIZE))
    for k in range(SAMPLE_SIZE):
        # The k-th draw among the rows that are left: skip those drawn before, in increasing order.
        row = (draws[:, k] * (head - k)).astype(np.int64)
        for earlier in np.sort(rows[:, :k], axis=1).T:
            row += row >= earlier
        rows[:, k] = row
    return rows


def plane_and_parallax(
    F: FloatArray, x1: FloatArray, x2: FloatArray, *, threshold_px: float, plane_px: float, count: int
) -> FloatArray:
    """Mend an F whose support lies on one plane: that plane with the epipole of every two matches off it.

    Returns ``[e']x H``, shape (P, 3, 3), of the best `count` one-to-one matches that lie `plane_px` or more off the
    homography H; none where no plane holds half of the support of `F`.

    References: Chum, Werner and Matas, Two-view geometry estimation unaffected by a dominant plane, CVPR 2005; Hartley
    and Zisserman, algorithm 13.2. That every two matches are tried, in place of samples, is ours.
    """
    support = sampson_distance(F, x1, x2) < threshold_px
    H = fit_homography(x1[support], x2[support], plane_px)
    if H is None:
        return np.empty((0, 3, 3))
    on_plane = homography_distance(H, x1, x2) < plane_px
    if np.count_nonzero(on_plane & support) < 0.5 * np.count_nonzero(support):
        return np.empty((0, 3, 3))
    off = np.flatnonzero(~on_plane)[:count]
    return models_of_plane(H, x1[off], x2[off])


def models_of_plane(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return ``[e']x H`` for the epipole e' at which the parallaxes of every two of the matches off a plane meet.

    `H` is the homography of the plane, ``x2 ~ H x1``.
    """
    ones = np.ones((len(x1), 1))
    # The line through where the plane would have put a point and where it is holds the epipole.
    lines = np.cross(np.hstack([x1, ones]) @ H.T, np.hstack([x2, ones]))
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-300)
    i, j = np.triu_indices(len(x1), 1)
    epipoles = np.cross(lines[i], lines[j])
    length = np.linalg.norm(epipoles, axis=1)
    e = epipoles[length > 0] / length[length > 0, None]
    S = np.zeros((len(e), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -e[:, 2], e[:, 1], -e[:, 0]
    models = (S - np.swapaxes(S, 1, 2)) @ (H / np.linalg.norm(H))
    return np.asarray(models / np.maximum(np.linalg.norm(models, axis=(1, 2), keepdims=True), 1e-300))
