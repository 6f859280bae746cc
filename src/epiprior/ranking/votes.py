"""Step 6: rough fundamental matrices from pairs of 2keypoint matches, and their votes (paper, section 4.5)."""

import numpy as np

from epiprior.geometry import as_columns, centred_columns, with_three_around
from epiprior.kernels.compilation import compiled
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.sampson import residual
from epiprior.kernels.solvers import fill_row
from epiprior.ranking.frames import MatchFrames
from epiprior.types import FloatArray, IntArray

_CHUNK = 512
_PAIRS = 1_250


def frame_points(
    frames: MatchFrames, main: IntArray, other: IntArray, *, frame: str = "feature", radius: float = 6.0
) -> tuple[FloatArray, FloatArray]:
    """Return the eight point matches that each of K 2keypoint matches gives: (K, 8, 2) in each image, working pixels.

    Each of its two matches gives itself and three points at angles theta + 2 pi k / 3 and `radius` sigma away (half the
    descriptor's window is 6), in both images by that match's own scale and orientation (the construction of BEEM, as we
    recall it). `frame` says which: ``feature``, those of SIFT; ``2keypoint``, those of the similarity that maps (p1,
    n1) to (p2, n2), of the size of the features.
    """
    rows = np.stack([main, other], axis=1)
    s1, s2 = frames.scale1[rows], frames.scale2[rows]
    a1, a2 = frames.orientation1_rad[rows], frames.orientation2_rad[rows]
    if frame == "2keypoint":
        v1, v2 = frames.x1[other] - frames.x1[main], frames.x2[other] - frames.x2[main]
        length1, length2 = np.hypot(*v1.T), np.hypot(*v2.T)
        a1 = np.repeat(np.arctan2(v1[:, 1], v1[:, 0])[:, None], 2, axis=1)
        a2 = np.repeat(np.arctan2(v2[:, 1], v2[:, 0])[:, None], 2, axis=1)
        size = np.sqrt(s1 * s2)
        ratio = np.sqrt(length2 / length1)[:, None]
        s1, s2 = size / ratio, size * ratio
    y1, y2 = with_three_around(frames.x1[rows], s1 * radius, a1), with_three_around(frames.x2[rows], s2 * radius, a2)
    return y1.reshape(-1, 8, 2), y2.reshape(-1, 8, 2)


def rough_fundamental_matrices(y1: FloatArray, y2: FloatArray) -> FloatArray:
    """Return a rough fundamental matrix for every two 2keypoint matches, by the normalised eight-point algorithm.

    From points (K, 8, 2) matrices (K (K - 1) / 2, 3, 3) of rank 2 and Frobenius norm 1, in the order (0, 1), (0, 2),
    ..., (1, 2), ... (Hartley and Zisserman, algorithm 11.1).
    """
    i, j = np.triu_indices(len(y1), 1)
    F = np.empty((len(i), 3, 3))

    def work(part: slice) -> None:
        F[part] = _fit_pairs(y1, y2, i[part], j[part])

    in_chunks(work, len(i), _PAIRS)
    return F


def _fit_pairs(y1: FloatArray, y2: FloatArray, i: IntArray, j: IntArray) -> FloatArray:
    p1, T1 = _condition_pairs(y1, i, j)
    p2, T2 = _condition_pairs(y2, i, j)
    _, vectors = np.linalg.eigh(_moments(p1, p2))
    U, s, Vt = np.linalg.svd(vectors[:, :, 0].reshape(-1, 3, 3))
    s[:, 2] = 0
    F = np.swapaxes(T2, 1, 2) @ (U * s[:, None, :]) @ Vt @ T1
    return np.asarray(F / np.linalg.norm(F, axis=(1, 2), keepdims=True))


def _condition_pairs(y: FloatArray, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the conditioned 16 points of each pair, (P, 16, 2), and the maps that made them, (P, 3, 3)."""
    p = np.concatenate([y[i], y[j]], axis=1)
    centre = p.mean(axis=1, keepdims=True)
    p = p - centre
    factor = np.sqrt(2.0 / np.maximum((p**2).sum(axis=2).mean(axis=1), 1e-18))
    T = np.zeros((len(p), 3, 3))
    T[:, 0, 0] = T[:, 1, 1] = factor
    T[:, :2, 2] = -factor[:, None] * centre[:, 0]
    T[:, 2, 2] = 1
    return p * factor[:, None, None], T


@compiled
def _moments(p1, p2):  # type: ignore[no-untyped-def]
    """Return A'A of the eight-point equations of each group of points."""
    out = np.zeros((len(p1), 9, 9))
    row = np.empty(9)
    for k in range(len(p1)):
        for q in range(p1.shape[1]):
            fill_row(row, p1[k, q, 0], p1[k, q, 1], p2[k, q, 0], p2[k, q, 1])
            for a in range(9):
                for b in range(a + 1):
                    out[k, a, b] += row[a] * row[b]
        for a in range(9):
            for b in range(a):
                out[k, b, a] = out[k, a, b]
    return out


@compiled(fastmath={"contract", "arcp", "nsz"})
def add_votes(F, weights, x, y, u, v, limit_sq, votes, weighted):  # type: ignore[no-untyped-def]
    """Add, per match, the matrices within the limit and their weights, in the order of the matrices.

    The inner loop is over matches: its sums are independent, so that vector instructions change no bit.
    """
    count = np.zeros(len(x), np.int32)
    none = np.float32(0)
    for k in range(F.shape[1]):
        f0, f1, f2 = F[0, k], F[1, k], F[2, k]
        f3, f4, f5 = F[3, k], F[4, k], F[5, k]
        f6, f7, f8 = F[6, k], F[7, k], F[8, k]
        w = weights[k]
        for m in range(len(x)):
            e, gradient_sq = residual(f0, f1, f2, f3, f4, f5, f6, f7, f8, x[m], y[m], u[m], v[m])
            hit = e * e < limit_sq * gradient_sq
            count[m] += np.int32(hit)
            weighted[m] += w if hit else none
    for m in range(len(x)):
        votes[m] = count[m]


def count_votes(
    F: FloatArray, x1: FloatArray, x2: FloatArray, threshold: float = 3.0, weights: FloatArray | None = None
) -> tuple[IntArray, FloatArray]:
    """Count for each match the matrices it supports, the paper's sfm, and sum their weights (1 by default), shape (M,).

    A match supports a matrix when its Sampson distance is below `threshold` pixels; threads change no count.
    """
    votes, weighted = np.zeros(len(x1), np.int64), np.zeros(len(x1), np.float32)
    if not len(F) or not len(x1):
        return votes, weighted.astype(np.float64)
    # Single precision is exact enough for centred coordinates: the largest term is of the order of the image's size.
    c1, c2 = x1.mean(axis=0), x2.mean(axis=0)
    columns = centred_columns(F, c1, c2)
    w = np.ones(len(F), np.float32) if weights is None else weights.astype(np.float32)
    points = as_columns(x1 - c1, x2 - c2).astype(np.float32)

    def work(part: slice) -> None:
        add_votes(columns, w, *points[:, part], np.float32(threshold**2), votes[part], weighted[part])

    in_chunks(work, len(x1), _CHUNK)
    return votes, weighted.astype(np.float64)
