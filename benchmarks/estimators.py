"""Hypotheses per second of our own loop, and time per call of every estimator, on synthetic matches.

    python benchmarks/estimators.py [--sizes 1000 3000 8000] [--repeats 5] [--share 0.1]

Our loop: the cap on the samples is reached, since nothing but the cap may end it; counted are samples drawn, solved,
scored, and optimised where they were the best so far (a sample of seven matches gives up to three hypotheses). All
runs are on one thread; seconds are processor time, so that what else the machine does matters less.
"""

import argparse
import statistics
import time
from dataclasses import replace

import numpy as np

from epiprior.estimators import EstimatorSettings, find_estimator, fit, list_estimators
from epiprior.estimators.own import LoopEstimator, search
from epiprior.types import MatchSet

WIDTH, HEIGHT, FOCAL = 1024, 768, 900.0
SAMPLES = 5_000


def synthetic_matches(count: int, share: float, seed: int = 0) -> MatchSet:
    """Return matches of two cameras side by side, a share of them right, in an order that knows the truth to a degree.

    Right matches have scales and orientations that nearly agree.
    """
    rng = np.random.default_rng(seed)
    right = np.arange(count) < round(share * count)
    x1 = rng.uniform(0, [WIDTH, HEIGHT], (count, 2))
    depth = rng.uniform(8, 12, count)
    c, s = np.cos(0.15), np.sin(0.15)
    ray = np.column_stack([(x1 - [WIDTH / 2, HEIGHT / 2]) / FOCAL, np.ones(count)]) * depth[:, None]
    turned = (ray - [1.2, 0.2, -0.3]) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    seen = turned[:, :2] / turned[:, 2:] * FOCAL + [WIDTH / 2, HEIGHT / 2]
    x2 = np.where(right[:, None], seen, rng.uniform(0, [WIDTH, HEIGHT], (count, 2)))
    x1, x2 = (x + rng.normal(0, 0.5, x.shape) for x in (x1, x2))
    logit = 3 * (rng.normal(np.where(right, 1.2, -1.2), 1.0)) + np.log(share / (1 - share))
    scale, angle = rng.uniform(2, 8, count), rng.uniform(0, 360, count)
    matches = MatchSet(
        x1=x1,
        x2=x2,
        scale1=scale,
        scale2=np.where(right, scale * np.exp(rng.normal(0, 0.1, count)), rng.uniform(2, 8, count)),
        orientation1_deg=angle,
        orientation2_deg=np.where(right, angle + rng.normal(0, 5, count), rng.uniform(0, 360, count)) % 360,
        feature1=np.arange(count),
        feature2=np.arange(count),
        probability=1 / (1 + np.exp(-logit)),
        supporting_matrices=np.zeros(count, np.int64),
        distance_ratio=np.full(count, 0.8),
        similarity_weight=np.zeros(count),
        similarity=np.full(count, 0.9),
        two_keypoint_probability=np.zeros(count),
    )
    return matches.take(np.argsort(-logit))


def without_prior(matches: MatchSet, share: float) -> MatchSet:
    """Return the matches in a random order, all equally probable."""
    equal = replace(matches, probability=np.full(len(matches), share))
    return equal.take(np.random.default_rng(1).permutation(len(matches)))


def rate(estimator: LoopEstimator, matches: MatchSet, repeats: int) -> float:
    """Return samples per second of processor time where only the cap ends the loop."""
    recipe = replace(estimator.recipe, min_iterations=SAMPLES)
    prior = estimator.prior(matches)
    rates = []
    for seed in range(repeats + 1):
        start = time.process_time()
        search(
            matches,
            prior,
            recipe,
            threshold_px=1.5,
            confidence=0.99,
            max_iterations=SAMPLES,
            seed=seed,
        )
        rates.append(SAMPLES / (time.process_time() - start))
    return statistics.median(rates[1:])  # the first run may compile


def milliseconds(name: str, matches: MatchSet, repeats: int) -> float:
    """Return processor time per call as epiprior runs the estimator, without its verdict."""
    times = []
    for seed in range(repeats + 1):
        start = time.process_time()
        fit(name, matches, seed=seed, settings=EstimatorSettings())
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times[1:])


def main() -> None:
    """Parse arguments and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 3000, 8000])
    parser.add_argument("--call-sizes", type=int, nargs="+", default=[500, 1000, 3000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--share", type=float, default=0.1, help="of right matches")
    options = parser.parse_args()
    names = [name for name, state in list_estimators().items() if state == "available"]

    for prior in ("probabilities", "no prior, any order"):
        sets = {n: synthetic_matches(n, options.share) for n in options.sizes}
        if prior != "probabilities":  # then no hypothesis bails out early
            sets = {n: without_prior(matches, options.share) for n, matches in sets.items()}
        print(f"\nsamples drawn and scored per second, {options.share:.0%} right matches, {prior}")
        print(f"{'matches':20s}" + "".join(f"{n:>10d}" for n in sets))
        for name in names:
            estimator = find_estimator(name)
            if isinstance(estimator, LoopEstimator):
                rates = [rate(estimator, matches, options.repeats) for matches in sets.values()]
                print(f"{name:20s}" + "".join(f"{r:10,.0f}" for r in rates), flush=True)

    sets = {n: synthetic_matches(n, options.share) for n in options.call_sizes}
    print(f"\nmilliseconds per call, {options.share:.0%} right matches")
    print(f"{'matches':20s}" + "".join(f"{n:>10d}" for n in sets))
    for name in names:
        times = [milliseconds(name, matches, options.repeats) for matches in sets.values()]
        print(f"{name:20s}" + "".join(f"{t:10.1f}" for t in times), flush=True)


if __name__ == "__main__":
    main()
