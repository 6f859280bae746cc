"""Compiled samples: a random generator of our own, draws weighted by a prior, checks of what was drawn.

Matches are columns of an array of shape (4, N): x and y in image 1, x and y in image 2. The state of the generator is
an array of one uint64, which every draw advances; numpy's global state is never touched.

References: splitmix64 (Steele, Lea and Flood, OOPSLA 2014); Chum, Werner and Matas, Epipolar geometry estimation via
RANSAC benefits from the oriented epipolar constraint, ICPR 2004, and Two-view geometry estimation unaffected by a
dominant plane, CVPR 2005; Hartley and Zisserman, 13.6 (the homography of F and three points).
"""

import numpy as np
from numpy.typing import NDArray

from epiprior.kernels.algebra import det3, epipoles
from epiprior.kernels.compilation import compiled

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S11, _S27, _S30, _S31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)
_TRIES_PER_MATCH = 20
# Whichever five of the seven matches lie on a plane, one of these triplets is among them (CVPR 2005, as we recall it).
_TRIPLETS = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 6], [3, 4, 6], [2, 5, 6]])


@compiled
def next_uniform(state):  # type: ignore[no-untyped-def]
    """Return a number in [0, 1) and advance `state`, shape (1,), uint64 (splitmix64)."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    z = z ^ (z >> _S31)
    return np.float64(z >> _S11) * 1.1102230246251565e-16


@compiled
def draw(cumulative, state):  # type: ignore[no-untyped-def]
    """Return an index with probability proportional to the steps of `cumulative`; steps of zero are never drawn."""
    wanted = next_uniform(state) * cumulative[-1]
    low, high = 0, len(cumulative) - 1
    while low < high:
        middle = (low + high) // 2
        if cumulative[middle] > wanted:
            high = middle
        else:
            low = middle + 1
    return low


@compiled
def fill_sample(head, tail, split, size, state, columns, separation_sq, sample):  # type: ignore[no-untyped-def]
    """Draw a sample of `size`, its first `split` entries by the sums `head`, the others by `tail`.

    No two of them are close in either image. Returns False where too many draws in a row were refused.
    """
    for k in range(size):
        cumulative = head if k < split else tail
        if cumulative[-1] <= 0:
            return False
        found = False
        for _ in range(_TRIES_PER_MATCH):
            i = draw(cumulative, state)
            found = True
            for j in sample[:k]:
                d1 = (columns[0, i] - columns[0, j]) ** 2 + (columns[1, i] - columns[1, j]) ** 2
                d2 = (columns[2, i] - columns[2, j]) ** 2 + (columns[3, i] - columns[3, j]) ** 2
                if d1 <= separation_sq or d2 <= separation_sq:
                    found = False
                    break
            if found:
                sample[k] = i
                break
        if not found:
            return False
    return True


@compiled
def same_side(F, columns, sample):  # type: ignore[no-untyped-def]
    """Return whether the matches of the sample lie on the same side of their epipoles (oriented constraint)."""
    right, left = np.empty(3), np.empty(3)
    epipoles(F, right, left)
    sign = 0.0
    for i in sample:
        u, v = columns[2, i], columns[3, i]
        c0 = left[1] - left[2] * v
        c1 = left[2] * u - left[0]
        x, y = columns[0, i], columns[1, i]
        s = c0 * (F[0, 0] * x + F[0, 1] * y + F[0, 2]) + c1 * (F[1, 0] * x + F[1, 1] * y + F[1, 2])
        s += (left[0] * v - left[1] * u) * (F[2, 0] * x + F[2, 1] * y + F[2, 2])
        if s * sign < 0.0:
            return False
        if sign == 0.0:
            sign = s
    return True


@compiled
def on_one_plane(F, columns, sample, limit_sq):  # type: ignore[no-untyped-def]
    """Return the largest number of the seven matches of a sample that agree with one homography compatible with `F`.

    The homographies are those of five triplets of the sample (DEGENSAC); a match agrees where its transfer error in
    image 2, squared, is below `limit_sq`. The triplet itself counts: three at least, if any homography can be had.
    """
    right, e = np.empty(3), np.empty(3)
    epipoles(F, right, e)
    A = np.empty((3, 3))
    for j in range(3):
        A[0, j] = e[1] * F[2, j] - e[2] * F[1, j]
        A[1, j] = e[2] * F[0, j] - e[0] * F[2, j]
        A[2, j] = e[0] * F[1, j] - e[1] * F[0, j]
    most = 0
    M, column = np.empty(9), np.empty(9)
    b, normal = np.empty(3), np.empty(3)
    for t in range(5):
        for r in range(3):
            i = sample[_TRIPLETS[t, r]]
            x, y, u, v = columns[0, i], columns[1, i], columns[2, i], columns[3, i]
            M[3 * r], M[3 * r + 1], M[3 * r + 2] = x, y, 1.0
            a0 = A[0, 0] * x + A[0, 1] * y + A[0, 2]
            a1 = A[1, 0] * x + A[1, 1] * y + A[1, 2]
            a2 = A[2, 0] * x + A[2, 1] * y + A[2, 2]
            p0, p1, p2 = v * a2 - a1, a0 - u * a2, u * a1 - v * a0
            q0, q1, q2 = v * e[2] - e[1], e[0] - u * e[2], u * e[1] - v * e[0]
            n = q0 * q0 + q1 * q1 + q2 * q2
            b[r] = (p0 * q0 + p1 * q1 + p2 * q2) / n if n > 1e-12 else 0.0
        d = det3(M)
        if abs(d) < 1e-9:
            continue  # three points on a line
        for c in range(3):
            for k in range(9):
                column[k] = b[k // 3] if k % 3 == c else M[k]
            normal[c] = det3(column) / d
        agree = 0
        for i in sample:
            x, y = columns[0, i], columns[1, i]
            depth = normal[0] * x + normal[1] * y + normal[2]
            h0 = A[0, 0] * x + A[0, 1] * y + A[0, 2] - e[0] * depth
            h1 = A[1, 0] * x + A[1, 1] * y + A[1, 2] - e[1] * depth
            h2 = A[2, 0] * x + A[2, 1] * y + A[2, 2] - e[2] * depth
            r0, r1 = h0 - columns[2, i] * h2, h1 - columns[3, i] * h2
            agree += r0 * r0 + r1 * r1 < limit_sq * h2 * h2
        most = max(most, agree)
    return most


def generator_state(seed: int) -> NDArray[np.uint64]:
    """Return the state of a generator seeded with `seed` >= 0."""
    return np.array([seed], dtype=np.uint64)


def cumulated(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cumulative sum of non-negative weights; where all are zero, of ones."""
    total = np.cumsum(weights)
    return total if len(total) and total[-1] > 0 else np.cumsum(np.ones(len(weights)))
