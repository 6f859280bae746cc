"""Which pairs of a collection are matched: all, neighbours in a sequence, those of a list, those that look alike."""

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from epiprior.errors import SettingsError
from epiprior.types import Float32Array

MOST_EXHAUSTIVE = 200
SIMILAR = 20
Pair = tuple[int, int]

_WORDS = 4096
_SAMPLE = 200_000  # descriptors that the words are made of
_LEAST_SHARE = 8  # descriptors of the sample per word
_ROUNDS = 8
_BLOCK = 8192


def default_pairs(count: int) -> str:
    """Return how pairs of so many images are chosen unless it is said."""
    return "exhaustive" if count <= MOST_EXHAUSTIVE else f"similar:{SIMILAR}"


def choose_pairs(
    how: str, names: Sequence[str], descriptors: Callable[[int], Float32Array] | None = None
) -> list[Pair] | None:
    """Return pairs of places in the sorted `names` of the images, the lower first, in ascending order.

    `how` is ``exhaustive``; ``sequential:K``: each image and the K after it by name; ``similar:K``: each image and the
    K that share most of their visual words; else a file, one pair of names per line, as hloc and COLMAP write it.
    `descriptors` returns the unit descriptors of an image, (N, D). Without it, ``similar`` gives None: not yet known.
    SettingsError if `how` is none of these, a line of the file is no pair of images, or no pair is left.
    """
    kind, _, number = how.partition(":")
    if how == "exhaustive":
        return list(combinations(range(len(names)), 2))
    if kind in ("sequential", "similar"):
        if not number.isdecimal() or int(number) < 1:
            raise SettingsError(f"pairs = {how!r}: expected {kind}:K, such as {kind}:10")
        if kind == "sequential":
            return [(a, b) for a in range(len(names)) for b in range(a + 1, min(a + 1 + int(number), len(names)))]
        return None if descriptors is None else similar_pairs(len(names), descriptors, int(number))
    if not Path(how).is_file():
        raise SettingsError(f"pairs = {how!r}: expected exhaustive, sequential:K, similar:K or a file, there is none")
    return _listed(Path(how), {name: place for place, name in enumerate(names)})


def _listed(path: Path, places: dict[str, int]) -> list[Pair]:
    pairs: set[Pair] = set()
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: not a list of pairs: {error}") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        # A name may hold blanks: the line is cut where both parts are names.
        cuts = {(line[:k].strip(), line[k:].strip()) for k, letter in enumerate(line) if letter.isspace()}
        found = [cut for cut in cuts if all(part in places for part in cut)]
        if len(found) != 1:
            what = f"{line.strip()!r} is not two names of images of this collection"
            raise SettingsError(f"{path}: line {number}: {what}")
        a, b = (places[part] for part in found[0])
        if a == b:
            raise SettingsError(f"{path}: line {number}: {found[0][0]!r} is paired with itself")
        pairs.add((min(a, b), max(a, b)))
    if not pairs:
        raise SettingsError(f"{path}: holds no pair")
    return sorted(pairs)


def similar_pairs(count: int, descriptors: Callable[[int], Float32Array], most: int) -> list[Pair]:
    """Return each image with the `most` others that are most alike by their visual words, each pair once.

    The words are learnt from the collection itself (spherical k-means, 4,096 words at most); an image is the square
    root of its counts, weighted by how rare a word is, at unit length. Memory grows with images times words.
    """
    share = max(1, _SAMPLE // max(count, 1))
    rng = np.random.default_rng(0)

    def some(index: int) -> Float32Array:
        d = descriptors(index)
        return d if len(d) <= share else d[np.sort(rng.choice(len(d), share, replace=False))]

    sample = np.concatenate([some(index) for index in range(count)])
    if not len(sample):
        raise SettingsError(f"pairs = 'similar:{most}': the images have no features")
    words = _learn_words(sample, rng)
    counts = np.zeros((count, len(words)), np.float32)
    for index in range(count):
        counts[index] = np.bincount(_nearest(descriptors(index), words), minlength=len(words))
    weight = np.log(count / np.maximum((counts > 0).sum(axis=0), 1))
    vectors = np.sqrt(counts) * weight.astype(np.float32)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-12))
    pairs: set[Pair] = set()
    for index in range(count):
        alike = vectors @ vectors[index]
        alike[index] = -np.inf
        nearest = np.argsort(-alike, kind="stable")[: min(most, count - 1)].tolist()
        pairs.update((min(index, other), max(index, other)) for other in nearest)
    return sorted(pairs)


def _learn_words(sample: Float32Array, rng: np.random.Generator) -> Float32Array:
    words = sample[np.sort(rng.choice(len(sample), min(_WORDS, -(-len(sample) // _LEAST_SHARE)), replace=False))]
    for _ in range(_ROUNDS):
        label = _nearest(sample, words)
        order = np.argsort(label, kind="stable")
        used, start = np.unique(label[order], return_index=True)
        sums = np.add.reduceat(sample[order], start, axis=0)
        words = words.copy()
        words[used] = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.float32(1e-12))
    return words


def _nearest(descriptors: Float32Array, words: Float32Array) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    blocks = (descriptors[first : first + _BLOCK] for first in range(0, len(descriptors), _BLOCK))
    parts = [(block @ words.T).argmax(axis=1) for block in blocks]
    return np.concatenate([np.empty(0, np.int64), *parts])
