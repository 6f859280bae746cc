"""Could random matches do as well? The null model behind what `epiprior.verification.facts` says of a support.

The best of many hypotheses always finds supporters, even among pure noise: 11 of 100 random matches, measured. Whether
a support means anything is a question of how many supporters random matches would give. How often one random match lies
within the threshold of F is measured on the pair itself, by joining points of image 1 with points of image 2 that
belong to other matches; unlike a formula over the image's area, this sees clustered points and epipoles inside.

References: the idea is that of a-contrario RANSAC (Moisan and Stival, IJCV 2004); the count of hypotheses is ours.
"""

import math

import numpy as np
from scipy.special import bdtrc

from epiprior.geometry import first_of_equal, sampson_distance
from epiprior.types import BoolArray, FloatArray

HYPOTHESES = 100_000
MATCHES_PER_F = 7
_PAIRINGS = 20_000
_PRIOR_PAIRINGS = 50.0


def distinct_count(x1: FloatArray, x2: FloatArray) -> int:
    """Return how many matches remain if those that share a point, in either image, count once.

    An upper bound, exact for one-to-one matches: the smaller of the numbers of distinct points in the two images.
    """
    return min(len(first_of_equal(x)) for x in (x1, x2))


def chance_rate(F: FloatArray, x1: FloatArray, x2: FloatArray, threshold_px: float) -> float:
    """Return the probability, in (0, 1), that a random match lies within a Sampson distance of `threshold_px` of F.

    Points of different matches, shape (N, 2), are joined to about 20,000 pairings. Few matches give few pairings; the
    rate is then drawn towards that of a strip of the threshold's width across the rectangle that the points fill.
    """
    n = len(x1)
    if n < 2:
        return 1.0
    shifts = np.unique(np.linspace(1, n - 1, max(1, min(n - 1, _PAIRINGS // n))).astype(int))
    partner = (np.arange(n) - shifts[:, None]) % n
    y1, y2 = np.tile(x1, (len(shifts), 1)), x2[partner.reshape(-1)]
    hits = int(np.count_nonzero(sampson_distance(F, y1, y2) < threshold_px))
    # The mean chord of a w x h rectangle is pi w h / (2 (w + h)); a Sampson threshold t is a strip of 2 sqrt(2) t.
    extent = max(float(np.ptp(x2, axis=0).sum()), 1e-9)
    strip = min(math.sqrt(2.0) * math.pi * threshold_px / extent, 1.0)
    return min((hits + _PRIOR_PAIRINGS * strip) / (len(y1) + _PRIOR_PAIRINGS), 1.0)


def log_chance(supporters: int, matches: int, rate: float, fitted: int) -> float:
    """Return the decimal logarithm of how many random hypotheses are expected to have as many `supporters`.

    As many are counted as can be drawn, up to 100,000 (20,000 samples of up to three matrices each, and their local
    optimisation). `rate` is the probability that a random match agrees with a hypothesis it did not make; `fitted`
    matches make a hypothesis and agree with it for free: 7 for F, 4 for a homography. Never below -300; ``log10`` of
    the hypotheses where no more than `fitted` agree.
    """
    drawn = max(_drawn(matches, fitted), 1.0)
    if supporters <= fitted or matches <= fitted:
        return math.log10(drawn)
    by_chance = float(bdtrc(supporters - fitted - 1, matches - fitted, min(rate, 1.0)))
    return max(math.log10(drawn) + math.log10(max(by_chance, 1e-300)), -300.0)


def expected_by_chance(agrees: BoolArray, rates: FloatArray, fitted: int) -> float:
    """Return how many random hypotheses are expected to have as many supporters; each match has a rate of its own.

    `log_chance`, not as a logarithm, for `rates`, shape (N,), in [0, 1]. Of the matches that agree, the
    `fitted` least probable make a hypothesis and agree for free; ``inf`` where no more agree than that.
    """
    supporters = np.flatnonzero(agrees)
    if len(supporters) <= fitted:
        return math.inf
    made_it = supporters[np.argsort(rates[supporters], kind="stable")[:fitted]]
    wanted = len(supporters) - fitted
    # Law of the number of supporters, all from `wanted` on in the last entry: one match after the other.
    law = np.zeros(wanted + 1)
    law[0] = 1.0
    for rate in np.delete(rates, made_it):
        last = law[-1] + rate * law[-2]
        law[1:] += rate * (law[:-1] - law[1:])
        law[0] *= 1.0 - rate
        law[-1] = last
    return float(_drawn(len(rates), fitted) * law[-1])


def _drawn(matches: int, fitted: int) -> float:
    """Return how many hypotheses can be drawn, up to `HYPOTHESES`."""
    return min(float(math.comb(matches, fitted)), float(HYPOTHESES))
