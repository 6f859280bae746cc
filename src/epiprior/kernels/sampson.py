"""The Sampson distance, once: every kernel that measures how far a match lies from F calls `residual`.

Matches are columns of an array of shape (4, N): x and y in image 1, x and y in image 2.

References: Hartley and Zisserman, Multiple View Geometry, 2nd ed., equation 11.9.
"""

from __future__ import annotations

import numpy as np

from epiprior.kernels.compilation import compiled


@compiled(inline="always")
def residual(f0, f1, f2, f3, f4, f5, f6, f7, f8, x, y, u, v):  # type: ignore[no-untyped-def]
    """Return ``e = x2' F x1`` and its squared gradient g: the squared Sampson distance is ``e * e / g``.

    F is given row by row. In the precision, and with the rounding, of the caller: the code is copied into it.
    """
    l0 = f0 * x + f1 * y + f2
    l1 = f3 * x + f4 * y + f5
    l2 = f6 * x + f7 * y + f8
    r0 = f0 * u + f3 * v + f6
    r1 = f1 * u + f4 * v + f7
    return u * l0 + v * l1 + l2, l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1


@compiled(inline="always")
def residual_of(F, x, y, u, v):  # type: ignore[no-untyped-def]
    """Return `residual` of `F`, shape (3, 3)."""
    return residual(F[0, 0], F[0, 1], F[0, 2], F[1, 0], F[1, 1], F[1, 2], F[2, 0], F[2, 1], F[2, 2], x, y, u, v)


@compiled(error_model="numpy")
def squared_distances(F, columns, out):  # type: ignore[no-untyped-def]
    """Write the squared Sampson distance of every match to `out`; inf where both epipolar lines are undefined."""
    for i in range(len(out)):
        e, gradient = residual_of(F, columns[0, i], columns[1, i], columns[2, i], columns[3, i])
        out[i] = e * e / gradient if gradient > 0.0 else np.inf


@compiled(error_model="numpy")
def tukey_weights(F, columns, gain, limit_sq, out):  # type: ignore[no-untyped-def]
    """Write Tukey's weight of every match times its `gain`, over the squared gradient.

    Divided by the squared gradient, the algebraic residual that a weighted fit minimises is the Sampson distance.
    """
    for i in range(len(out)):
        e, gradient = residual_of(F, columns[0, i], columns[1, i], columns[2, i], columns[3, i])
        rest = 1.0 - e * e / (gradient * limit_sq) if gradient > 0.0 else 0.0
        out[i] = gain[i] * rest * rest / gradient if rest > 0.0 else 0.0
