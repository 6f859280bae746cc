"""What many pairs cost: pairs per core-hour, memory per worker, and a million pairs, from a few pairs measured.

    python benchmarks/scale.py PAIR_SET [PAIR_SET ...] [--pairs 10] [--estimator magsac++] [--price 0.05]

Pairs are taken evenly from each set and go through ranking and estimation in one worker: a process of its own with
one thread. Its processor time is counted, which what else the machine does changes little. The first pair, which
also loads libraries and the model, is counted apart.
"""

import argparse
import multiprocessing
import resource
import statistics
import time
from pathlib import Path

import epiprior
from epiprior_lab.compute.tasks import single_threaded
from epiprior_lab.pairsets import Pair, read_pair_set

MILLION = 1_000_000


def measure(pairs: list[Pair], estimator: str) -> tuple[list[float], float, list[int]]:
    """Return processor seconds per pair, peak memory in GiB, and how many matches each pair has."""
    seconds, matches = [], []
    with single_threaded():
        for pair in pairs:
            start = time.process_time()
            ranked = epiprior.rank_matches(pair.image1, pair.image2)
            epiprior.estimate_fundamental(pair.image1, pair.image2, estimator=estimator, ranked=ranked)
            seconds.append(time.process_time() - start)
            matches.append(len(ranked.sets[0]))
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, matches


def report(root: Path, count: int, estimator: str, price: float) -> None:
    """Measure one set in a fresh process and print a line per number."""
    pairs = read_pair_set(root).pairs
    chosen = [pairs[k * len(pairs) // count] for k in range(min(count, len(pairs)))]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        seconds, peak, matches = pool.apply(measure, (chosen[:1] + chosen, estimator))
    first, rest = seconds[0], seconds[1:]
    mean = statistics.mean(rest)
    hours = MILLION * mean / 3600
    print(f"{root}: {len(rest)} of {len(pairs)} pairs, {estimator}, median {statistics.median(matches):.0f} matches")
    print(f"  first pair of a worker         {first:8.1f} s")
    print(f"  a pair, mean (least to most)   {mean:8.2f} s ({min(rest):.2f} to {max(rest):.2f})")
    print(f"  pairs per core-hour            {3600 / mean:8.0f}")
    print(f"  peak memory of a worker        {peak:8.2f} GiB")
    print(f"  a million pairs                {hours:8.0f} core-hours, {hours / (24 * 100):.1f} days on 100 cores,")
    print(f"                                 {hours * price:8.0f} at {price:g} per core-hour")


def main() -> None:
    """Print the numbers of every set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", type=Path, help="folders with a pairs.csv")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--estimator", default="magsac++")
    parser.add_argument("--price", type=float, default=0.05, help="of a core for an hour, any currency")
    options = parser.parse_args()
    for root in options.sets:
        report(root, options.pairs, options.estimator, options.price)


if __name__ == "__main__":
    main()
