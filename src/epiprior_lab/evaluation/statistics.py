"""Successes and paired bootstrap intervals.

Errors are pixels, ``inf`` or NaN where there is no fundamental matrix, which counts as a failure and never as missing;
a success is an error strictly below the threshold; deviations over seeds are sample deviations. References: paper,
"General performance"; Efron and Tibshirani, An Introduction to the Bootstrap, chapter 13 (percentile intervals).
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from epiprior.types import FloatArray

_LEVEL = 0.95
_TAILS = ((1 - _LEVEL) / 2, 1 - (1 - _LEVEL) / 2)


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate on the data themselves and the ends of its percentile bootstrap interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Paired comparison of a measure without and with the preprocessing step: means over pairs.

    `difference` is ``with - without``, `contribution` the paper's ``(with - without) / without`` of the means.
    """

    without: Interval
    with_step: Interval
    difference: Interval
    contribution: Interval


def contribution(without: ArrayLike, with_step: ArrayLike) -> FloatArray:
    """Return the paper's ``(with - without) / without`` of successes: 0 over 0 is 0, others over 0 are ``inf``."""
    a, b = np.broadcast_arrays(np.asarray(without, np.float64), np.asarray(with_step, np.float64))
    out = np.where(b > 0, np.inf, 0.0)
    return np.asarray(np.divide(b - a, a, out=out, where=a > 0))


@functools.lru_cache(maxsize=4)  # tables hold several inputs against one under the same draw
def bootstrap_weights(n: int, draws: int, seed: int, groups: tuple[str, ...] | None) -> FloatArray:
    """Return how often each of `n` pairs is drawn in each of `draws` samples, as shares, shape (draws, n).

    Each row sums to 1, so that ``weights @ values`` are the means of the samples. `groups` names the scene of each
    pair: whole scenes are drawn, because pairs of one scene are alike; without it, pairs.
    """
    _, group = np.unique(np.arange(n) if groups is None else np.asarray(groups, str), return_inverse=True)
    number = int(group.max()) + 1
    counts = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), size=draws)[:, group]
    weights: FloatArray = counts / counts.sum(axis=1, keepdims=True)
    weights.flags.writeable = False
    return weights


def _interval(value: float, samples: FloatArray) -> Interval:
    """Take the quantiles without interpolation: a sample may be infinite."""
    low, high = np.quantile(samples, _TAILS, method="inverted_cdf")
    return Interval(value=float(value), low=float(low), high=float(high))


def bootstrap_mean(values: ArrayLike, *, draws: int, seed: int, groups: Sequence[str] | None = None) -> Interval:
    """Return the mean of `values`, one finite value per pair, and its interval, drawn as in `bootstrap_weights`."""
    v = np.asarray(values, np.float64)
    weights = bootstrap_weights(len(v), draws, seed, None if groups is None else tuple(groups))
    return _interval(v.mean(), weights @ v)


def paired_bootstrap(
    without: ArrayLike, with_step: ArrayLike, *, draws: int, seed: int, groups: Sequence[str] | None = None
) -> Comparison:
    """Compare a measure of the same pairs without and with the preprocessing step, resampled together.

    Both hold one finite value per pair, shape (N,), N >= 1; for successes, the share of seeds that succeeded. `draws`,
    `seed`, `groups` are as for `bootstrap_weights`.
    """
    a, b = np.asarray(without, np.float64), np.asarray(with_step, np.float64)
    weights = bootstrap_weights(len(a), draws, seed, None if groups is None else tuple(groups))
    means_a, means_b = weights @ a, weights @ b
    return Comparison(
        without=_interval(a.mean(), means_a),
        with_step=_interval(b.mean(), means_b),
        difference=_interval((b - a).mean(), means_b - means_a),
        contribution=_interval(float(contribution(a.mean(), b.mean())), contribution(means_a, means_b)),
    )


def success_curve(errors_px: ArrayLike, thresholds_px: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the number of successful pairs at each threshold: mean over seeds, and its sample deviation.

    `errors_px` has shape (pairs, seeds), pixels; the deviation is 0 for a single seed.
    """
    below = np.asarray(errors_px, np.float64)[None] < np.asarray(thresholds_px, np.float64)[:, None, None]
    counts = below.sum(axis=1).astype(np.float64)
    deviation = counts.std(axis=1, ddof=1) if counts.shape[1] > 1 else np.zeros(len(counts))
    return counts.mean(axis=1), deviation


def area_under_success_curve(errors_px: ArrayLike, limit_px: float) -> float:
    """Return the mean share of successes over all thresholds from 0 to `limit_px`, > 0.

    It is exact, not a sum over a grid: each error e adds ``max(0, 1 - e / limit)``.
    """
    errors = np.nan_to_num(np.asarray(errors_px, np.float64), nan=np.inf)
    return float(np.clip(1 - errors / limit_px, 0, 1).mean())
