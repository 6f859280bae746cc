"""Compiled random draws: a generator of our own, samples weighted by a prior, samples without shared points.

Matches are columns of an array of shape (4, N): x and y in image 1, x and y in image 2. The state of the
generator is an array of one uint64, which every draw advances; numpy's global state is never touched.

References: splitmix64 (Steele, Lea and Flood, OOPSLA 2014).
"""

from __future__ import annotations

import numba
import numpy as np

from epiprior.types import FloatArray

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S11, _S27, _S30, _S31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)
_TRIES_PER_MATCH = 20


@numba.njit(cache=True, nogil=True)
def next_uniform(state):  # type: ignore[no-untyped-def]
    """Return a number in [0, 1) and advance `state`, shape (1,), uint64 (splitmix64)."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    z = z ^ (z >> _S31)
    return np.float64(z >> _S11) * 1.1102230246251565e-16


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
def fill_sample(cumulative, state, columns, separation_sq, sample, first, last):  # type: ignore[no-untyped-def]
    """Draw the entries ``sample[first:last]``, none close to an earlier entry of the sample in either image.

    Returns False where too many draws in a row were refused.
    """
    if cumulative[-1] <= 0:
        return False
    for k in range(first, last):
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


def generator_state(seed: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Return the state of a generator seeded with `seed` >= 0."""
    return np.array([seed], dtype=np.uint64)


def cumulated(weights: FloatArray) -> FloatArray:
    """Return the cumulative sum of non-negative weights; where all are zero, of ones."""
    total = np.cumsum(weights)
    return total if len(total) and total[-1] > 0 else np.cumsum(np.ones(len(weights)))
