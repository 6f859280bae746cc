"""Matches along the epipolar lines of a known F: what it finds beside the matches that it was estimated from.

A feature is compared only with those near its epipolar line, among which the right one stands out where it does not
among all of the image. A collection gathers the matches of every F that it relies on in this way, since a mapper needs
many of them. They do not confirm F: a wrong one finds matches of its own.
"""

import numpy as np

from epiprior.features.describe import normalise_descriptors
from epiprior.features.locations import unique_locations
from epiprior.kernels.compilation import compiled
from epiprior.kernels.descriptor import inner_product
from epiprior.kernels.sampson import residual
from epiprior.types import Features, Float32Array, FloatArray, IntArray

MAX_DISTANCE_RATIO = 0.8
MAX_ANGLE = 0.7  # radians, between descriptors; both limits are COLMAP's


@compiled
def _similar_on_lines(F, x1, x2, d1, d2, limit_sq, order, first, last):  # type: ignore[no-untyped-def]
    """Return the pairs of features below a squared Sampson distance, and their similarities.

    Each feature of image 1 is compared with those of its band in image 2: places ``first`` to ``last`` of `order`.
    """
    f0, f1, f2 = F[0, 0], F[0, 1], F[0, 2]
    f3, f4, f5 = F[1, 0], F[1, 1], F[1, 2]
    f6, f7, f8 = F[2, 0], F[2, 1], F[2, 2]
    found, similarity = np.empty((32 * len(x1) + len(x2), 2), np.int64), np.empty(32 * len(x1) + len(x2), np.float32)
    u, v, inside, total = x2[order, 0], x2[order, 1], np.empty(len(order), np.bool_), 0
    for i in range(len(x1)):
        x, y = x1[i, 0], x1[i, 1]
        for k in range(first[i], last[i]):  # vector instructions
            e, g = residual(f0, f1, f2, f3, f4, f5, f6, f7, f8, x, y, u[k], v[k])
            inside[k] = e * e < limit_sq * g
        if total + last[i] - first[i] > len(similarity):
            found = np.concatenate((found, np.empty_like(found)))
            similarity = np.concatenate((similarity, np.empty_like(similarity)))
        for k in range(first[i], last[i]):
            if inside[k]:
                found[total, 0], found[total, 1] = i, order[k]
                similarity[total] = inner_product(d1[i], d2[order[k]])
                total += 1
    return found[:total], similarity[:total]


def _bands(F: FloatArray, x1: FloatArray, x2: FloatArray, limit_sq: float) -> tuple[IntArray, IntArray, IntArray]:
    """Return features of image 2 by the angle of their epipolar lines, and where the band of each of image 1 lies.

    With the singular vectors of F, ``x2' F x1`` is an inner product p . q of vectors of the plane, which vanishes where
    these are perpendicular. A band, ``first`` to ``last``, holds all features whose squared Sampson distance may be
    below the limit: few, unless some feature lies near an epipole.
    """
    size = max([1.0, *(float(x.std(axis=0).max()) for x in (x1, x2) if len(x))])
    T1, T2 = (np.array([[size, 0, x], [0, size, y], [0, 0, 1]]) for x, y in (_centre(x1), _centre(x2)))
    F = T2.T @ F @ T1  # for points around 0, of about 1
    X1, X2 = (np.column_stack([(x - _centre(x)) / size, np.ones(len(x))]) for x in (x1, x2))
    U, S, V = np.linalg.svd(F)
    p, q = X2 @ U[:, :2] * S[:2], X1 @ V[:2].T
    angle, across = (np.mod(np.arctan2(y, x), np.pi) for x, y in (p.T, (-q[:, 1], q[:, 0])))
    p_sq, q_sq = (np.maximum((v**2).sum(axis=1), 1e-100) for v in (p, q))
    gradient1, gradient2 = ((X1 @ F.T)[:, :2] ** 2).sum(axis=1), ((X2 @ F)[:, :2] ** 2).sum(axis=1)
    most = gradient1 * (1 / p_sq).max(initial=0.0) + (gradient2 / p_sq).max(initial=0.0)
    half = np.arcsin(np.sqrt(np.minimum(1.001 * limit_sq / size**2 * most / q_sq, 1.0))) + 1e-9
    order = np.argsort(angle, kind="stable")
    angles = np.concatenate([angle[order] - np.pi, angle[order], angle[order] + np.pi])
    first, last = np.searchsorted(angles, across - half), np.searchsorted(angles, across + half)
    return np.tile(order, 3), first, np.minimum(last, first + len(order))


def _centre(x: FloatArray) -> FloatArray:
    return np.asarray(x.mean(axis=0)) if len(x) else np.zeros(2)


@compiled
def _two_best(row, column, place, similarity, nearest, best):  # type: ignore[no-untyped-def]
    """Enter pairs into the nearest of each row and its two highest similarities, the second of another place."""
    for k in range(len(row)):
        i, j, s = row[k], column[k], similarity[k]
        other = nearest[i] < 0 or place[nearest[i]] != place[j]
        if s > best[i, 0]:
            if other:
                best[i, 1] = best[i, 0]
            best[i, 0], nearest[i] = s, j
        elif other and s > best[i, 1]:
            best[i, 1] = s


def guided_matches(
    features1: Features, features2: Features, F: FloatArray, *, threshold_px: float, factors: tuple[float, float]
) -> IntArray:
    """Return mutual nearest neighbours (RootSIFT) near the epipolar lines of F, (M, 2), lowest distance ratio first.

    Matches name the first feature at a location and scale. Their Sampson distance is below `threshold_px` in working
    pixels, of which `factors` are the given pixels in both images. The angle between their descriptors is at most
    `MAX_ANGLE`, and its ratio to that of the next feature elsewhere near the line at most `MAX_DISTANCE_RATIO`, in both
    images; a right angle stands in where there is no other.
    """
    sides = (features1, features2)
    d1, d2 = (normalise_descriptors(side.descriptors, root=True, centred=False) for side in sides)
    x1, x2 = (side.xy.astype(np.float64) / factor for side, factor in zip(sides, factors, strict=True))
    D1, D2 = (np.diag([factor, factor, 1.0]) for factor in factors)
    scaled = D2 @ F @ D1
    scaled /= np.linalg.norm(scaled)
    bands = _bands(scaled, x1, x2, threshold_px**2)
    found, similarity = _similar_on_lines(scaled, x1, x2, d1, d2, threshold_px**2, *bands)
    (first1, place1), (first2, place2) = (unique_locations(side) for side in sides)
    nearest1, angle1, ratio1 = _nearest(found[:, 0], found[:, 1], place2, similarity, len(features1))
    nearest2, _, ratio2 = _nearest(found[:, 1], found[:, 0], place1, similarity, len(features2))
    rows = np.flatnonzero(nearest1 >= 0)
    to = nearest1[rows]
    ratio = np.maximum(ratio1[rows], ratio2[to])
    mutual = place1[nearest2[to]] == place1[rows]
    keep = np.flatnonzero(mutual & (angle1[rows] <= MAX_ANGLE) & (ratio <= MAX_DISTANCE_RATIO))
    keep = keep[np.argsort(ratio[keep], kind="stable")]
    matches = np.column_stack([first1[place1[rows[keep]]], first2[place2[to[keep]]]])
    return matches[np.sort(np.unique(matches, axis=0, return_index=True)[1])]  # twins find the same


def _nearest(
    row: IntArray, column: IntArray, place: IntArray, similarity: Float32Array, count: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the nearest for each of `count` rows (-1: none), its angle, and the ratio of that to the next."""
    nearest, best = np.full(count, -1, np.int64), np.zeros((count, 2), np.float32)
    _two_best(row, column, place, similarity, nearest, best)
    angle = np.arccos(np.clip(best.astype(np.float64), -1.0, 1.0))
    return nearest, angle[:, 0], np.maximum(angle[:, 0], 1e-12) / np.maximum(angle[:, 1], 1e-12)
