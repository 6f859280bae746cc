"""Compiled scores of hypotheses over all matches, with early bail-out.

Three scores of one form: every match within a limit of F adds a value between 0 and its `gain`.

- `SUPPORT` (MSAC): ``gain (1 - r^2 / t^2)``; the truncated quadratic, weighted where gains are not one.
- `LIKELIHOOD` (Guided-MLESAC): ``log(1 + odds exp(-r^2 / 2 sigma^2))``. This is the log likelihood of the mixture
  ``v p_in(r) + (1 - v) / w`` over that of the outlier alone, ``odds = v / (1 - v) w p_in(0)``.
- `KERNEL` (BLOGS-style probabilistic support): ``gain exp(-r^2 / 2 sigma^2)``.

A match adds at most a known value; once a hypothesis cannot reach the best score any more, the rest is not looked at.
With the best matches first this happens early. The result is the same as without. Residuals are Sampson distances r in
the unit of the columns, see `epiprior.kernels.solvers`.

References: MSAC, MLESAC: Torr and Zisserman, CVIU 2000; Guided-MLESAC: Tordoff and Murray, TPAMI 2005 (as we recall
it).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from epiprior.types import FloatArray

SUPPORT, LIKELIHOOD, KERNEL = 0, 1, 2
BLOCK = 128
_CUT_SIGMAS = 3.0


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def residual_parts(F, columns, first, last, error_sq, gradient_sq):  # type: ignore[no-untyped-def]
    """Write the squared algebraic error and the squared gradient of the matches first..last; r^2 is their ratio."""
    x, y, u, v = columns[0, first:last], columns[1, first:last], columns[2, first:last], columns[3, first:last]
    f0, f1, f2 = F[0, 0], F[0, 1], F[0, 2]
    f3, f4, f5 = F[1, 0], F[1, 1], F[1, 2]
    f6, f7, f8 = F[2, 0], F[2, 1], F[2, 2]
    for i in range(len(x)):
        l0 = f0 * x[i] + f1 * y[i] + f2
        l1 = f3 * x[i] + f4 * y[i] + f5
        l2 = f6 * x[i] + f7 * y[i] + f8
        r0 = f0 * u[i] + f3 * v[i] + f6
        r1 = f1 * u[i] + f4 * v[i] + f7
        e = u[i] * l0 + v[i] * l1 + l2
        error_sq[i] = e * e
        gradient_sq[i] = l0 * l0 + l1 * l1 + r0 * r0 + r1 * r1


@numba.njit(cache=True, nogil=True)
def score(F, columns, gain, rest, kind, sigma, limit, floor, work):  # type: ignore[no-untyped-def]
    """Return the score of `F`, or some number <= `floor` where the score is not above it.

    `gain`, shape (N,): what each match adds at most, or its odds for `LIKELIHOOD`. `rest`: what the blocks from each
    block on add at most, from `attainable`. `sigma`: t for `SUPPORT`. Matches farther than `limit` add nothing.
    `work`, shape (2, BLOCK): scratch.
    """
    n = columns.shape[1]
    limit_sq, total = limit * limit, 0.0
    factor = 1.0 / (sigma * sigma) if kind == SUPPORT else 0.5 / (sigma * sigma)
    for block in range(len(rest) - 1):
        if total + rest[block] <= floor:
            return floor
        first = block * BLOCK
        last = min(first + BLOCK, n)
        residual_parts(F, columns, first, last, work[0], work[1])
        for i in range(last - first):
            if work[0, i] < limit_sq * work[1, i]:
                q = factor * work[0, i] / work[1, i]
                if kind == SUPPORT:
                    total += gain[first + i] * (1.0 - q)
                elif kind == KERNEL:
                    total += gain[first + i] * math.exp(-q)
                else:
                    total += math.log1p(gain[first + i] * math.exp(-q))
    return total


@numba.njit(cache=True, nogil=True)
def squared_residuals(F, columns, out):  # type: ignore[no-untyped-def]
    """Write the squared Sampson distances of all matches to `out`; inf where they are undefined."""
    gradient_sq = np.empty(len(out))
    residual_parts(F, columns, 0, len(out), out, gradient_sq)
    for i in range(len(out)):
        out[i] = out[i] / gradient_sq[i] if gradient_sq[i] > 0.0 else np.inf


def attainable(gain: FloatArray, kind: int) -> FloatArray:
    """Return what all blocks from each on can add at most: shape (blocks + 1,), the last entry 0."""
    highest = np.log1p(gain) if kind == LIKELIHOOD else gain
    sums = np.add.reduceat(highest, np.arange(0, len(gain), BLOCK)) if len(gain) else np.zeros(0)
    # A hair more than exact, so that rounding can't make a hypothesis bail out that is better.
    return np.concatenate([np.cumsum(sums[::-1])[::-1] * (1 + 1e-9), [0.0]])


def likelihood_odds(validity: FloatArray, sigma: float, width: float) -> FloatArray:
    """Return the odds of `LIKELIHOOD`: of an inlier at distance 0 against an outlier somewhere in `width`.

    Parameters
    ----------
    validity : ndarray, shape (N,), float64
        Prior probability v of each match, in [0, 1]; kept to [0.001, 0.999].
    sigma : float
        Standard deviation of the distance of an inlier, whose density at 0 is ``sqrt(2 / pi) / sigma``.
    width : float
        Range w over which outliers are spread evenly, in the unit of `sigma`.
    """
    v = np.clip(validity, 0.001, 0.999)
    odds: FloatArray = v / (1 - v) * width * math.sqrt(2 / math.pi) / sigma
    return odds


def cut_distance(kind: int, sigma: float) -> float:
    """Return the distance beyond which a match adds nothing: t for `SUPPORT`, else three sigma."""
    return sigma if kind == SUPPORT else _CUT_SIGMAS * sigma
