"""Plane and parallax: mend an F whose support lies on one plane, which leaves its epipole undecided."""

from __future__ import annotations

import numpy as np

from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray
from epiprior.verification.degeneracy import fit_homography, homography_distance

_NONE = np.empty((0, 3, 3))


def plane_and_parallax(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    *,
    threshold_px: float,
    plane_px: float,
    count: int,
    min_share: float = 0.5,
) -> FloatArray:
    """Return the F of the plane that most of the support lies on, with the epipole of every two matches off it.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        A hypothesis.
    x1, x2 : ndarray, shape (N, 2), float64
        Matches, pixels, one-to-one, best first.
    threshold_px : float
        Sampson distance below which a match supports F.
    plane_px : float
        Distance from the homography below which a match is of the plane.
    count : int
        So many of the best matches off the plane take part.
    min_share : float
        Least share of the support that must lie on one plane.

    Returns
    -------
    ndarray, shape (P, 3, 3), float64
        ``[e']x H``, P = count (count - 1) / 2 at most; none where no plane holds enough of the support.

    References
    ----------
    Chum, Werner and Matas, Two-view geometry estimation unaffected by a dominant plane, CVPR 2005; Hartley and
    Zisserman, algorithm 13.2. That every two matches are tried, in place of samples, is ours.
    """
    support = sampson_distance(F, x1, x2) < threshold_px
    H = fit_homography(x1[support], x2[support], plane_px)
    if H is None:
        return _NONE
    on_plane = homography_distance(H, x1, x2) < plane_px
    if np.count_nonzero(on_plane & support) < min_share * np.count_nonzero(support):
        return _NONE
    off = np.flatnonzero(~on_plane)[:count]
    return models_of_plane(H, x1[off], x2[off])


def models_of_plane(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return ``[e']x H`` for the epipole e' at which the parallaxes of every two of the matches meet.

    Parameters
    ----------
    H : ndarray, shape (3, 3)
        Homography of the plane, ``x2 ~ H x1``.
    x1, x2 : ndarray, shape (N, 2), float64
        Matches off the plane.
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
    size = np.linalg.norm(models, axis=(1, 2), keepdims=True)
    return np.asarray(models / np.maximum(size, 1e-300))
