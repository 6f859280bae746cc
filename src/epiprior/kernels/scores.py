"""Compiled scores of hypotheses over all matches: one by one in the loop, many at once for ``epiprior``.

The loop has three scores of one form: every match within a limit of F adds a value between 0 and its `gain`.

- `SUPPORT` (MSAC): ``gain (1 - r^2 / t^2)``; the truncated quadratic, weighted where gains are not one.
- `LIKELIHOOD` (Guided-MLESAC): ``log(1 + odds exp(-r^2 / 2 sigma^2))``. This is the log likelihood of the mixture
  ``v p_in(r) + (1 - v) / w`` over that of the outlier alone, ``odds = v / (1 - v) w p_in(0)``.
- `KERNEL` (BLOGS-style probabilistic support): ``gain exp(-r^2 / 2 sigma^2)``.

A match adds at most a known value; once a hypothesis cannot reach the best score any more, the rest is not looked at.
With the best matches first this happens early. The result is the same as without. Residuals are Sampson distances r in
the unit of the columns, see `epiprior.kernels.solvers`.

References: MSAC, MLESAC: Torr and Zisserman, CVIU 2000; Guided-MLESAC: Tordoff and Murray, TPAMI 2005 (from memory).
"""

import math

import numpy as np
from numpy.typing import NDArray

from epiprior.kernels.compilation import compiled
from epiprior.kernels.sampson import residual, residuals

SUPPORT, LIKELIHOOD, KERNEL = 0, 1, 2
BLOCK = 128
_CUT_SIGMAS = 3.0


@compiled
def score(F, columns, gain, rest, kind, sigma, limit, floor, work):  # type: ignore[no-untyped-def]
    """Return the score of `F`, or some number <= `floor` where the score is not above it.

    `gain`, shape (N,): what each match adds at most, or its odds for `LIKELIHOOD`. `rest`: what the blocks from each
    on add at most, from `attainable`. `sigma`: t for `SUPPORT`. Matches beyond `limit` add nothing; `work` is scratch.
    """
    n = columns.shape[1]
    limit_sq, total = limit * limit, 0.0
    factor = 1.0 / (sigma * sigma) if kind == SUPPORT else 0.5 / (sigma * sigma)
    for block in range(len(rest) - 1):
        if total + rest[block] <= floor:
            return floor
        first = block * BLOCK
        last = min(first + BLOCK, n)
        residuals(F, columns, first, last, work[0], work[1])
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


@compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def score_models(F, columns, weights, group, limit_sq, scores):  # type: ignore[no-untyped-def]
    """Add up, per model, what the matches say for it; `scores` (K,) is written.

    `F` is (9, K); matches are sorted by `group`, and of each group the best counts: w (1 - r^2 / limit_sq). A match for
    whose points `F` has no epipolar lines says nothing; nor does any match for a model of zeros.
    """
    n = columns.shape[1]
    one, none = np.float32(1), np.float32(0)
    best = np.empty(BLOCK, np.float32)
    for start in range(0, F.shape[1], BLOCK):
        count = min(BLOCK, F.shape[1] - start)
        G = F[:, start : start + count]
        total = scores[start : start + count]
        for k in range(count):
            best[k] = total[k] = none
        for m in range(n):
            x, y, u, v, w = columns[0, m], columns[1, m], columns[2, m], columns[3, m], weights[m]
            for k in range(count):
                e, gradient_sq = residual(
                    G[0, k], G[1, k], G[2, k], G[3, k], G[4, k], G[5, k], G[6, k], G[7, k], G[8, k], x, y, u, v
                )
                square = e * e / gradient_sq
                value = w * (one - square / limit_sq)
                best[k] = value if value > best[k] else best[k]
            if m == n - 1 or group[m + 1] != group[m]:
                for k in range(count):
                    total[k] += best[k]
                    best[k] = none


@compiled
def score_of_groups(squares, weights, group, limit_sq):  # type: ignore[no-untyped-def]
    """Return what `score_models` returns for one model, from its squared distances."""
    total = best = 0.0
    for m in range(len(squares)):
        best = max(best, weights[m] * (1.0 - squares[m] / limit_sq))
        if m == len(squares) - 1 or group[m + 1] != group[m]:
            total += best
            best = 0.0
    return total


def attainable(gain: NDArray[np.float64], kind: int) -> NDArray[np.float64]:
    """Return what all blocks from each on can add at most: shape (blocks + 1,), the last entry 0."""
    highest = np.log1p(gain) if kind == LIKELIHOOD else gain
    sums = np.add.reduceat(highest, np.arange(0, len(gain), BLOCK)) if len(gain) else np.zeros(0)
    # A hair more than exact, so that rounding can't make a hypothesis bail out that is better.
    return np.concatenate([np.cumsum(sums[::-1])[::-1] * (1 + 1e-9), [0.0]])


def likelihood_odds(validity: NDArray[np.float64], sigma: float, width: float) -> NDArray[np.float64]:
    """Return the odds of `LIKELIHOOD`: of an inlier at distance 0 against an outlier somewhere in `width`.

    `validity`, shape (N,), is the prior probability v of each match, kept to [0.001, 0.999]; `sigma` the standard
    deviation of the distance of an inlier, whose density at 0 is ``sqrt(2 / pi) / sigma``; `width` the range w over
    which outliers are spread evenly, in the unit of `sigma`.
    """
    v = np.clip(validity, 0.001, 0.999)
    odds: NDArray[np.float64] = v / (1 - v) * width * math.sqrt(2 / math.pi) / sigma
    return odds


def cut_distance(kind: int, sigma: float) -> float:
    """Return the distance beyond which a match adds nothing: t for `SUPPORT`, else three sigma."""
    return sigma if kind == SUPPORT else _CUT_SIGMAS * sigma
