"""Pairs that contradict each other: what matches say of three images, after Zach, Klopschitz and Pollefeys (CVPR 2010).

A feature of image a is matched with one of b, and both are matched in c: with one place, or with two. Where a pair
takes one house for its twin, or one window for the next, many of its matches meet at two places.
"""

import functools
import heapq
import itertools
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from epiprior.collection.pairs import Pair
from epiprior.kernels.compilation import compiled
from epiprior.types import Float32Array, IntArray

Triplet = tuple[int, int, int]
_SAME_PLACE_PX = 8.0  # features of several sizes sit at one corner
_OPEN, _CHANCE = 0.2, 0.05  # more open loops are too many; and how sure of that a triplet has to be
_VOTE = 2.0  # log odds; on rendered houses a vote against is worth 3.5, but the triplets of a pair share pairs
_MOST = 20  # triplets of a pair that are looked at
_SURE = 0.995


@dataclass(frozen=True)
class Counts:
    """Matches of three images whose ends are both matched in the third: those that meet there, and those that do not.

    A loop of three matches counts three times, and so does a wrong one of its matches.
    """

    closed: int
    open: int

    @property
    def vote(self) -> float:
        """For the three pairs, in log odds: negative where beyond chance too many are open, positive if too few are."""
        opened, total = self.open // 3, (self.closed + self.open) // 3
        if _chance(opened, total) < _CHANCE:
            return -_VOTE
        return _VOTE if 1 - _chance(opened + 1, total) < _CHANCE else 0.0


@functools.cache
def _chance(opened: int, total: int) -> float:
    """Return the probability of so many open loops or more where they are as frequent as is just not too many."""
    return float(binom.sf(opened - 1, total, _OPEN))


@compiled
def _meet(matches, in_third1, in_third2, xy, near2):  # type: ignore[no-untyped-def]
    """Count the matches both of whose ends are matched in a third image: at one place `xy`, and at two."""
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
    closed_c, open_c = _meet(ab, c_of_a, c_of_b, xy_c, near2)
    closed_b, open_b = _meet(ac, b_of_a, b_of_c, xy_b, near2)
    closed_a, open_a = _meet(bc, a_of_b, a_of_c, xy_a, near2)
    return closed_a + closed_b + closed_c, open_a + open_b + open_c


def count_loops(
    matches: tuple[IntArray, IntArray, IntArray], xy: tuple[Float32Array, Float32Array, Float32Array]
) -> Counts:
    """Count the loops of three images a, b, c whose features are at `xy`, (N, 2), working pixels.

    `matches` of a with b, a with c and b with c, each (M, 2) and one-to-one. The ends of a match meet in the third
    image if they are less than 8 pixels apart there.
    """
    return Counts(*map(int, _count(*matches, *xy, _SAME_PLACE_PX**2)))


def contradicted_pairs(
    confidence: Mapping[Pair, float], matches: Callable[[Pair], IntArray], xy: Callable[[int], Float32Array]
) -> set[Pair]:
    """Return the pairs to leave out so that no three images that were looked at contradict each other.

    Three images contradict each other where too many of their loops are open: a pair is wrong. One has to go, the least
    sure first, by the log odds of its confidence and the votes of all its triplets.

    Parameters
    ----------
    confidence : Of each pair of images a < b, that it is right.
    matches : Returns those of a pair, (M, 2).
    xy : Returns where the features of an image are, (N, 2), working pixels.
    """
    read = functools.lru_cache(maxsize=16_384)(matches)
    votes = {pair: _log_odds(sure) for pair, sure in confidence.items()}
    contradictory: set[Triplet] = set()
    of_pair: dict[Pair, list[tuple[Triplet, float]]] = defaultdict(list)
    for a, b, c in triplets(confidence):
        vote = count_loops((read((a, b)), read((a, c)), read((b, c))), (xy(a), xy(b), xy(c))).vote
        if vote < 0:
            contradictory.add((a, b, c))
        for pair in itertools.combinations((a, b, c), 2) if vote else ():
            votes[pair] += vote
            of_pair[pair].append(((a, b, c), vote))
    out: set[Pair] = set()
    in_doubt = {pair for triplet in contradictory for pair in itertools.combinations(triplet, 2)}
    heap = [(votes[pair], confidence[pair], pair) for pair in in_doubt]
    heapq.heapify(heap)
    while contradictory:
        score, _, worst = heapq.heappop(heap)
        if worst in out or score != votes[worst] or not any(t in contradictory for t, _ in of_pair[worst]):
            continue
        out.add(worst)
        for triplet, vote in of_pair[worst]:
            others = [pair for pair in itertools.combinations(triplet, 2) if pair != worst]
            if not out.intersection(others):  # else its votes are taken back already
                contradictory.discard(triplet)
                for pair in others:
                    votes[pair] -= vote
                    heapq.heappush(heap, (votes[pair], confidence[pair], pair))
    return out


def _log_odds(confidence: float) -> float:
    sure = min(max(confidence, 1 - _SURE), _SURE)
    return float(np.log(sure / (1 - sure)))


def triplets(confidence: Mapping[Pair, float]) -> list[Triplet]:
    """Return images a < b < c whose pairs are all there, ascending; of every pair those whose other pairs are surest.

    Those of a pair are 20 at the most.
    """
    near: dict[int, set[int]] = defaultdict(set)
    for a, b in confidence:
        near[a].add(b)
        near[b].add(a)

    def sure(a: int, b: int) -> float:
        return confidence[min(a, b), max(a, b)]

    found: set[Triplet] = set()
    for a, b in confidence:
        thirds = sorted((-min(sure(a, c), sure(b, c)), c) for c in near[a] & near[b])[:_MOST]
        found.update(tuple(sorted((a, b, c))) for _, c in thirds)  # type: ignore[misc]
    return sorted(found)
