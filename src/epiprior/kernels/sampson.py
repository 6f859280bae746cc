"""The Sampson distance, once: every kernel that measures how far a match lies from F calls `residual`.

Matches are columns of an array of shape (4, N): x and y in image 1, x and y in image 2.

References: Hartley and Zisserman, Multiple View Geometry, 2nd ed., equation 11.9.
"""

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


@compiled
def residuals(F, columns, first, last, error_sq, gradient_sq):  # type: ignore[no-untyped-def]
    """Write the squared error and the squared gradient of the matches first..last; r^2 is their ratio."""
    x, y, u, v = columns[0, first:last], columns[1, first:last], columns[2, first:last], columns[3, first:last]
    f0, f1, f2 = F[0, 0], F[0, 1], F[0, 2]
    f3, f4, f5 = F[1, 0], F[1, 1], F[1, 2]
    f6, f7, f8 = F[2, 0], F[2, 1], F[2, 2]
    for i in range(len(x)):
        e, gradient_sq[i] = residual(f0, f1, f2, f3, f4, f5, f6, f7, f8, x[i], y[i], u[i], v[i])
        error_sq[i] = e * e


@compiled
def squared_distances(F, columns, out, gradient_sq):  # type: ignore[no-untyped-def]
    """Write the squared Sampson distances of all matches; inf where both epipolar lines are undefined."""
    residuals(F, columns, 0, len(out), out, gradient_sq)
    for i in range(len(out)):
        out[i] = out[i] / gradient_sq[i] if gradient_sq[i] > 0.0 else np.inf


@compiled
def tukey_weights(F, columns, gain, limit_sq, out, gradient_sq):  # type: ignore[no-untyped-def]
    """Write Tukey's weight of every match times its `gain`, over the squared gradient.

    Divided by the squared gradient, the algebraic residual that a weighted fit minimises is the Sampson distance.
    """
    residuals(F, columns, 0, len(out), out, gradient_sq)
    for i in range(len(out)):
        rest = 1.0 - out[i] / (gradient_sq[i] * limit_sq) if gradient_sq[i] > 0.0 else 0.0
        out[i] = gain[i] * rest * rest / gradient_sq[i] if rest > 0.0 else 0.0
