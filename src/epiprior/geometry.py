"""Fundamental matrices from points, their refinement, and Sampson distances.

Conventions: ``x1, x2`` are ``(N, 2)`` float64 pixels; ``x2' F x1 = 0``; residuals are unsquared pixels. References:
Hartley and Zisserman, Multiple View Geometry, 2nd ed., chapter 11 (eight points: 11.2; Sampson: 11.4.3).
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from epiprior.errors import FeatureError
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.sampson import squared_distances, tukey_weights
from epiprior.kernels.scores import BLOCK, score_models
from epiprior.kernels.solvers import weighted_eight_point
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray, as_numbers, check_array

MIN_MATCHES = 8
SHRINKING_THRESHOLDS_PX = (10.0, 8.0, 6.0, 4.0, 3.0, 2.0, 2.0, 1.5, 1.5)
SCORE_THRESHOLD_PX = 2.0


def as_points(name: str, points: ArrayLike) -> FloatArray:
    """Return `points` as a contiguous float64 array of shape (N, 2).

    Raises FeatureError if the shape is another, or a value is not finite; the message carries `name`.
    """
    array = as_numbers(name, points)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 2))
    check_array(name, array, (None, 2))
    return array


def first_of_equal(rows: FloatArray) -> IntArray:
    """Return where each distinct row of `rows`, (N, D) finite numbers, stands first, in ascending order."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    new = np.concatenate([np.ones(min(len(rows), 1), np.bool_), (ordered[1:] != ordered[:-1]).any(axis=1)])
    return np.sort(order[new])


def normalise_fundamental(F: FloatArray) -> FloatArray | None:
    """Return `F` at rank 2, Frobenius norm 1 and with its largest entry positive.

    None where `F` has a shape other than (3, 3), holds a value that is not finite, or has rank below 2.
    """
    F = np.asarray(F, dtype=np.float64)
    if F.shape != (3, 3) or not np.isfinite(F).all():
        return None
    norm = float(np.linalg.norm(F))
    if norm == 0:
        return None
    U, s, Vt = np.linalg.svd(F / norm)
    if s[1] <= 1e-12 * s[0]:
        return None
    F = (U[:, :2] * s[:2]) @ Vt[:2]
    F /= np.linalg.norm(F)
    return F if F.flat[np.abs(F).argmax()] > 0 else -F


def sampson_distance(F: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return the Sampson distance of each match, in pixels: shape (N,), >= 0; inf where no epipolar line is defined.

    `F` is of any non-zero scale; `x1` and `x2` are pixels, shape (N, 2), N = 0 is allowed. Raises FeatureError if
    shapes disagree. Reference: Hartley and Zisserman, equation 11.9 (its square).
    """
    if x1.shape != x2.shape or x1.ndim != 2 or x1.shape[1] != 2:
        raise FeatureError(f"x1 and x2 have shapes {x1.shape} and {x2.shape}, expected (N, 2) twice")
    distance_sq = np.empty(len(x1))
    squared_distances(np.ascontiguousarray(F, dtype=np.float64), as_columns(x1, x2), distance_sq, np.empty(len(x1)))
    return np.sqrt(distance_sq)


def as_columns(x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return N matches as kernels read them: x and y in image 1, x and y in image 2, shape (4, N)."""
    columns = np.empty((4, len(x1)))
    columns[:2], columns[2:] = x1.T, x2.T
    return columns


def with_three_around(x: FloatArray, reach: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return points (..., 2), each with three around it, `reach` away, from an angle on by thirds: (..., 4, 2)."""
    angles = angle_rad[..., None] + 2 * np.pi * np.arange(3) / 3
    offsets = reach[..., None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.concatenate([x[..., None, :], x[..., None, :] + offsets], axis=-2)


def centred_columns(models: FloatArray, centre1: FloatArray, centre2: FloatArray) -> Float32Array:
    """Return fundamental matrices for points that are centred, as compiled kernels read them in single precision.

    `models`, shape (K, 3, 3), are for pixels, K = 0 is allowed; `centre1` and `centre2`, shape (2,), are subtracted
    from the points. Returns shape (9, K), float32: row by row, each matrix at a size at which neither its entries nor
    its residuals leave single precision.
    """
    T1, T2 = np.eye(3), np.eye(3)
    T1[:2, 2], T2[:2, 2] = centre1, centre2
    G = T2.T @ models @ T1
    size = np.abs(G).max(axis=(1, 2), keepdims=True)
    G /= np.abs(G[:, :2, :2]).max(axis=(1, 2), keepdims=True) + size * 1e-9 + 1e-300
    return np.ascontiguousarray(G.reshape(-1, 9).T, dtype=np.float32)


class Evidence:
    """N matches with their weights, arranged for scoring many F; of one group, (N,), only the best counts."""

    def __init__(self, x1: FloatArray, x2: FloatArray, weights: FloatArray, group: IntArray | None = None) -> None:
        group = np.arange(len(x1)) if group is None else group
        order = np.argsort(group, kind="stable")
        # Pixels from the means of the points: single precision is then exact enough.
        self.centre1, self.centre2 = (x.mean(axis=0) if len(x) else np.zeros(2) for x in (x1, x2))
        self.columns = as_columns((x1 - self.centre1)[order], (x2 - self.centre2)[order]).astype(np.float32)
        self.weights = weights[order].astype(np.float32)
        self.group = np.asarray(group[order], dtype=np.int64)

    def scores(self, models: FloatArray, threshold_px: float) -> FloatArray:
        """Return the score of each of `models` (K, 3, 3): shape (K,), float64, >= 0.

        A group says what its best match says: w (1 - r^2 / threshold^2) at the Sampson distance r, nothing beyond.
        """
        found = np.zeros(len(models), np.float32)
        if len(models) and len(self.weights):
            centred = centred_columns(models, self.centre1, self.centre2)
            limit_sq = np.float32(threshold_px**2)

            def work(part: slice) -> None:
                some = np.ascontiguousarray(centred[:, part])
                score_models(some, self.columns, self.weights, self.group, limit_sq, found[part])

            in_chunks(work, len(models), 2 * BLOCK)
        return np.nan_to_num(found.astype(np.float64), nan=0.0)


def different_models(supporters: Iterable[tuple[int, BoolArray]], count: int, same_share: float) -> list[int]:
    """Return the numbers of the first `count` models no two of which have about the same supporters, (N,).

    The same are two from an intersection over union of `same_share` on.
    """
    kept: dict[int, BoolArray] = {}
    for k, own in supporters:
        if len(kept) == count:
            break
        if all(np.sum(own & other) < same_share * np.sum(own | other) for other in kept.values()):
            kept[k] = own
    return list(kept)


def eight_point(x1: FloatArray, x2: FloatArray, weights: FloatArray | None = None) -> FloatArray | None:
    """Return the normalised (weighted) eight-point estimate (Hartley and Zisserman, algorithm 11.1).

    `x1` and `x2` are pixels, shape (N, 2), N >= 8; `weights`, shape (N,), >= 0, are of the squared algebraic residuals.
    Returns (3, 3), as by `normalise_fundamental`; None below 8 matches of positive weight or where nothing is decided.
    """
    w = np.ones(len(x1)) if weights is None else np.ascontiguousarray(weights, dtype=np.float64)
    F = np.empty((3, 3))
    return normalise_fundamental(F) if weighted_eight_point(as_columns(x1, x2), w, F) else None


def weighted_score(
    F: FloatArray, x1: FloatArray, x2: FloatArray, weights: FloatArray, threshold_px: float = SCORE_THRESHOLD_PX
) -> float:
    """Return the sum of the weights >= 0, each lowered by the match's squared distance; nothing from a threshold on."""
    r = sampson_distance(F, x1, x2) / threshold_px
    return float(weights @ np.maximum(1.0 - r * r, 0.0))


def refine_fundamental(
    F: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    weights: FloatArray | None = None,
    thresholds: Sequence[float] = SHRINKING_THRESHOLDS_PX,
    *,
    score_threshold_px: float = SCORE_THRESHOLD_PX,
) -> FloatArray:
    """Return the best F of a series of weighted eight-point fits over shrinking thresholds.

    Each fit takes the matches within the threshold of the F before it, by its weight, lowered towards the threshold
    (Tukey's biweight) and divided by the squared gradient of the residual, so that what is minimised is the Sampson
    distance. The F with the highest `weighted_score` is kept, the first one included: the result never scores less than
    what went in. It is normalised as by `normalise_fundamental`.

    `F`, (3, 3), should be within the first threshold of the truth on most right matches. `x1` and `x2`, (N, 2), are
    pixels of one-to-one matches, N < 8 returns `F`; `weights`, (N,), their probabilities, 1 by default. `thresholds`
    are pixels, from wide to narrow, `score_threshold_px` is that of the score that decides.

    References: shrinking thresholds: local optimisation of LO-RANSAC (Chum, Matas and Kittler, DAGM 2003) and of USAC.
    Weighing by the probabilities of the matches is ours.
    """
    w = np.ones(len(x1)) if weights is None else np.asarray(weights, dtype=np.float64)
    # Matches that are far off now do not come back; the fits then run on a fraction of the matches.
    near = (sampson_distance(F, x1, x2) < 3.0 * max(thresholds, default=0.0)) & (w > 0)
    if np.count_nonzero(near) < MIN_MATCHES:
        return F
    x1, x2, w = x1[near], x2[near], w[near]
    columns, fit_weights, scratch = as_columns(x1, x2), np.empty(len(w)), np.empty(len(w))
    best, best_score = F, weighted_score(F, x1, x2, w, score_threshold_px)
    current = F.copy()
    for threshold in thresholds:
        tukey_weights(current, columns, w, threshold * threshold, fit_weights, scratch)
        if not weighted_eight_point(columns, fit_weights, current):
            break
        score = weighted_score(current, x1, x2, w, score_threshold_px)
        if score > best_score:
            best, best_score = current.copy(), score
    normalised = None if best is F else normalise_fundamental(best)
    return F if normalised is None else normalised
