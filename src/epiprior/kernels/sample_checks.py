"""Compiled checks of minimal samples: matches on one side of the epipoles, matches of one plane.

Conventions as in `epiprior.kernels.solvers`.

References: Chum, Werner and Matas, Epipolar geometry estimation via RANSAC benefits from the oriented epipolar
constraint, ICPR 2004, and Two-view geometry estimation unaffected by a dominant plane, CVPR 2005; Hartley and
Zisserman, 13.6 (the homography of F and three points).
"""

from __future__ import annotations

import numba
import numpy as np

from epiprior.kernels.small_algebra import det3, epipoles

# Whichever five of the seven matches lie on a plane, one of these triplets is among them (CVPR 2005, as we recall it).
_TRIPLETS = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 6], [3, 4, 6], [2, 5, 6]])


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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
