"""Bags of photographs: grown over pairs that overlap, joined by a stranger, or taken from two twin scenes.

As in the Image Matching Challenge (Jin et al., Image Matching across Wide Baselines, IJCV 2021), but over the pairs of
the set: a bag starts with a photograph of a scene, and grows by one that is paired with one in it.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from epiprior_lab.bags.params import BagParams
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.pairsets import Camera, Pair

PLAIN, STRANGER, TWINS = "plain", "stranger", "twins"


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A photograph of a bag: its file, its true camera, and the place it shows; of different places nothing is seen."""

    image: Path
    camera: Camera
    place: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Bag:
    """Photographs that are mapped together; `size` is their number without strangers, `kind` as named above."""

    group: str
    scene: str
    kind: str
    size: int
    number: int
    views: tuple[View, ...]

    @property
    def name(self) -> str:
        """Of its tasks and rows, unique."""
        return f"{self.group}-{self.scene}-{self.kind}-{self.size}-{self.number}"

    @property
    def named(self) -> dict[str, View]:
        """The photographs by what they are called in the bag."""
        return {f"{k:02}{view.image.suffix.lower()}": view for k, view in enumerate(self.views)}


def plain_bags(sets: Mapping[str, Sequence[Pair]], params: BagParams) -> list[Bag]:
    """Return the bags of every scene with cameras that has so many photographs, all of a size different."""
    bags = []
    for group, pairs in sets.items():
        for scene, views in _scenes(pairs).items():
            near = _neighbours(pair for pair in pairs if pair.scene == scene)
            for size, count in params.per_scene.items():
                seen: set[tuple[Path, ...]] = set()
                for number in range(count):
                    rng = np.random.default_rng(child_seed(params.seed, "bags", group, scene, f"{size}", f"{number}"))
                    images = _grow(near, size, rng)
                    if images and images not in seen:
                        seen.add(images)
                        own = tuple(views[image] for image in images)
                        bags.append(Bag(group=group, scene=scene, kind=PLAIN, size=size, number=number, views=own))
    return bags


def stranger_bags(bags: Sequence[Bag], sets: Mapping[str, Sequence[Pair]], params: BagParams) -> list[Bag]:
    """Return the first bag of `stranger_size` of every scene, each with a photograph of another set."""
    found = []
    for bag in bags:
        if bag.size != params.stranger_size or bag.number:
            continue
        others = [
            v for name in sets if name != bag.group for scene in _scenes(sets[name]).values() for v in scene.values()
        ]
        if others:
            rng = np.random.default_rng(child_seed(params.seed, "strangers", bag.name))
            views = [*bag.views, others[rng.integers(len(others))]]
            views = [views[k] for k in rng.permutation(len(views))]  # no method is to profit from its place
            found.append(replace(bag, kind=STRANGER, views=tuple(views)))
    return found


def difficulty(bag: Bag, shares: Mapping[tuple[Path, Path], float], *, easy: float, hard: float) -> str:
    """Return ``easy``, ``medium`` or ``hard`` by the median share of right X_L over the bag's pairs; empty: unknown."""
    images = [view.image for view in bag.views]
    known = [shares[pair] for pair in itertools.permutations(images, 2) if pair in shares]
    if not known:
        return ""
    middle = float(np.median(known))
    return "easy" if middle > easy else "hard" if middle < hard else "medium"


def _scenes(pairs: Sequence[Pair]) -> dict[str, dict[Path, View]]:
    """Return the photographs with cameras of every scene, in the order of their paths."""
    scenes: dict[str, dict[Path, View]] = defaultdict(dict)
    for pair in pairs:
        for image, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2)):
            if camera is not None:
                place = f"{image.parents[1].name}/{pair.scene}"
                scenes[pair.scene][image] = View(image=image, camera=camera, place=place)
    return {scene: dict(sorted(views.items())) for scene, views in sorted(scenes.items())}


def _neighbours(pairs: Iterator[Pair]) -> dict[Path, set[Path]]:
    near: dict[Path, set[Path]] = defaultdict(set)
    for pair in pairs:
        near[pair.image1].add(pair.image2)
        near[pair.image2].add(pair.image1)
    return near


def _grow(near: Mapping[Path, set[Path]], size: int, rng: np.random.Generator) -> tuple[Path, ...]:
    """Return `size` photographs in order, or none where no part of the scene is so large."""
    for start in rng.permutation(len(near)):
        bag = [sorted(near)[start]]
        while len(bag) < size and (around := sorted(set().union(*(near[one] for one in bag)) - set(bag))):
            bag.append(around[rng.integers(len(around))])
        if len(bag) == size:
            return tuple(sorted(bag))
    return ()
