"""Pairs that contradict each other: what matches say of three images, after Zach, Klopschitz and Pollefeys (CVPR 2010).

A feature of image a is matched with one of b, and both are matched in c: with one place, or with two. Where a pair
takes one house for its twin, or one window for the next, most of its matches meet at two places.
"""

import functools
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from epiprior.kernels.compilation import compiled
from epiprior.types import FloatArray, IntArray

Pair = tuple[int, int]
Triplet = tuple[int, int, int]
_SAME_PLACE_PX = 8.0  # features of several sizes sit at one corner
_CHANCE = 0.01
_VOTE = 2.0  # on rendered houses closed triplets give log odds of 2.6, contradictory ones of -3.4; they share pairs
_MOST = 20  # triplets of a pair that are looked at
_SURE = 0.995


@dataclass(frozen=True)
class Counts:
    """Loops of matches through three images: how many are closed, and how many end at another place."""

    closed: int
    open: int

    @property
    def vote(self) -> float:
        """For the three pairs, in log odds: positive where more than half are closed beyond chance, or negative."""
        total = self.closed + self.open
        if binom.sf(max(self.closed, self.open) - 1, total, 0.5) >= _CHANCE:
            return 0.0
        return _VOTE if self.closed > self.open else -_VOTE


@compiled
def _meet(matches, in_third1, in_third2, xy, near2):  # type: ignore[no-untyped-def]
    """Count the matches both of whose ends are matched in a third image: at one place `xy`, or at two."""
    one = two = 0
    for row in range(len(matches)):
        first, second = in_third1[matches[row, 0]], in_third2[matches[row, 1]]
        if first < 0 or second < 0:
            continue
        dx, dy = xy[first, 0] - xy[second, 0], xy[first, 1] - xy[second, 1]
        if dx * dx + dy * dy < near2:
            one += 1
        else:
            two += 1
    return one, two


@compiled
def _count(ab, ac, bc, xy_a, xy_b, xy_c, near2):  # type: ignore[no-untyped-def]
    b_of_a, c_of_a = np.full(len(xy_a), -1), np.full(len(xy_a), -1)
    a_of_b, c_of_b = np.full(len(xy_b), -1), np.full(len(xy_b), -1)
    a_of_c, b_of_c = np.full(len(xy_c), -1), np.full(len(xy_c), -1)
    for matches, there, back in ((ab, b_of_a, a_of_b), (ac, c_of_a, a_of_c), (bc, c_of_b, b_of_c)):
        for row in range(len(matches)):
            there[matches[row, 0]], back[matches[row, 1]] = matches[row, 1], matches[row, 0]
    closed, in_c = _meet(ab, c_of_a, c_of_b, xy_c, near2)
    _, in_b = _meet(ac, b_of_a, b_of_c, xy_b, near2)
    _, in_a = _meet(bc, a_of_b, a_of_c, xy_a, near2)
    return closed, in_a + in_b + in_c


def count_loops(matches: tuple[IntArray, IntArray, IntArray], xy: tuple[FloatArray, FloatArray, FloatArray]) -> Counts:
    """Count the loops of three images a, b, c whose features are at `xy`, (N, 2), working pixels.

    `matches` of a with b, a with c and b with c, each (M, 2) and one-to-one. A loop is open where two ends of a match
    meet the third image more than 8 pixels apart.
    """
    return Counts(*map(int, _count(*matches, *xy, _SAME_PLACE_PX**2)))


def contradicted_pairs(
    confidence: Mapping[Pair, float], matches: Callable[[Pair], IntArray], xy: Callable[[int], FloatArray]
) -> set[Pair]:
    """Return the pairs to leave out so that no three images contradict each other.

    Three images contradict each other where most of their loops are open: a pair is wrong. One has to go, the least
    sure first, by the log odds of its confidence and the votes of all its triplets.

    Parameters
    ----------
    confidence : Of each pair of images a < b, that it is right.
    matches : Returns those of a pair, (M, 2).
    xy : Returns where the features of an image are, (N, 2), working pixels.
    """
    read = functools.lru_cache(maxsize=4096)(matches)
    votes = {pair: _log_odds(sure) for pair, sure in confidence.items()}
    contradictory: set[Triplet] = set()
    of_pair: dict[Pair, list[tuple[Triplet, float]]] = defaultdict(list)
    for a, b, c in _triplets(confidence):
        vote = count_loops((read((a, b)), read((a, c)), read((b, c))), (xy(a), xy(b), xy(c))).vote
        if vote < 0:
            contradictory.add((a, b, c))
        for pair in itertools.combinations((a, b, c), 2):
            votes[pair] += vote
            of_pair[pair].append(((a, b, c), vote))
    out: set[Pair] = set()
    while contradictory:
        in_doubt = {pair for triplet in contradictory for pair in itertools.combinations(triplet, 2)}
        worst = min(in_doubt, key=lambda pair: (votes[pair], pair))
        out.add(worst)
        for triplet, vote in of_pair[worst]:
            others = [pair for pair in itertools.combinations(triplet, 2) if pair != worst]
            if not out.intersection(others):  # else its votes are taken back already
                contradictory.discard(triplet)
                for pair in others:
                    votes[pair] -= vote
    return out


def _log_odds(confidence: float) -> float:
    sure = min(max(confidence, 1 - _SURE), _SURE)
    return float(np.log(sure / (1 - sure)))


def _triplets(confidence: Mapping[Pair, float]) -> Iterator[Triplet]:
    """Yield a < b < c whose pairs are all there, ascending; of a pair those whose other pairs are surest."""
    near: dict[int, set[int]] = defaultdict(set)
    for a, b in confidence:
        near[a].add(b)
        near[b].add(a)

    def least(triplet: Triplet) -> float:
        return min(confidence[pair] for pair in itertools.combinations(triplet, 2))

    found: set[Triplet] = set()
    for a, b in confidence:
        around: list[Triplet] = [tuple(sorted((a, b, c))) for c in near[a] & near[b]]  # type: ignore[misc]
        found.update(sorted(around, key=lambda triplet: (-least(triplet), triplet))[:_MOST])
    yield from sorted(found)
