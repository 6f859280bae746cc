"""What loops of matches through three images say of pairs, on rendered houses of facades-hard with known cameras.

    python benchmarks/contradictions.py [--houses 16] [--twins 14] [--work FOLDER]

Six photographs of each house, and four of each of two twins, are matched as `epiprior sfm` does, without and with focal
lengths. Prints how many of the pairs that reach the confidence are wrong: of two houses, or with a camera that is more
than ten degrees off and most matches off their true epipolar lines; how many of the wrong and the right ones are left
out because they contradict others; and how the triplets of right and of wrong pairs vote.
"""

import argparse
import itertools
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from epiprior.collection.loops import count_loops, triplets
from epiprior.collection.run import MatchedCollection, match_collection
from epiprior.collection.store import MatchedPair
from epiprior.collection.verify import CONTRADICTS_OTHERS, judge_pairs
from epiprior.geometry import sampson_distance
from epiprior_lab.bags.choose import View
from epiprior_lab.bags.methods import true_camera
from epiprior_lab.bags.twins import render_house
from epiprior_lab.evaluation.distances import pose_errors
from epiprior_lab.pairsets.cameras import fundamental_from_cameras

CONFIDENT, RIGHT_DEG, NEAR_PX = 0.5, 10.0, 4.0


def photographs(number: int, folder: Path, *, houses: int, pairs: int) -> dict[str, View]:
    """Render houses of one style, and return their photographs by name."""
    views = {}
    for house in range(houses):
        how = {"family": "facades-hard", "style_seed": 9500 + number, "seed": 17000 + 1000 * house + number}
        taken = render_house(name=f"house {number}", pairs=pairs, jpeg_quality=92, **how)  # type: ignore[arg-type]
        for k, (jpeg, camera) in enumerate(taken):
            image = folder / f"{number}{'ab'[house]}{k}.jpg"
            image.write_bytes(jpeg)
            views[image.name] = View(image=image, camera=camera, place="ab"[house])
    return views


def is_wrong(pair: MatchedPair, views: dict[str, View], matched: MatchedCollection, places: tuple[int, int]) -> bool:
    """Return whether a pair is of two houses, or its camera and most of its matches are wrong."""
    one, two = views[pair.image1], views[pair.image2]
    if one.place != two.place or pair.F is None:
        return one.place != two.place
    x1, x2 = (matched.features(k).xy[rows].astype(float) for k, rows in zip(places, pair.matches.T, strict=True))
    off = max(pose_errors(pair.F, (one.camera, two.camera), x1, x2)) > RIGHT_DEG
    F = fundamental_from_cameras(one.camera, two.camera)
    assert F is not None
    return bool(off and np.mean(sampson_distance(F, x1, x2) < NEAR_PX) < 0.5)


def measure(views: dict[str, View], work: Path, counts: dict[str, Counter[str]], kind: str) -> None:
    """Match, judge, and count."""
    cameras = {name: true_camera(view.camera) for name, view in views.items()}
    matched = match_collection([view.image for view in views.values()], cameras=cameras, work=work)
    for known, collection in (("unknown", matched.plain), ("known", matched)):
        counted = counts[f"{kind}, {known} focal lengths"]
        found = {
            places: (pair, why)
            for places, (pair, why) in zip(matched.pairs, judge_pairs(collection, CONFIDENT), strict=True)
            if why in ("", CONTRADICTS_OTHERS)
        }
        wrong = {places: is_wrong(pair, views, matched, places) for places, (pair, _) in found.items()}
        for places, (_, why) in found.items():
            counted[f"{'wrong' if wrong[places] else 'right'}{' left out' if why else ''}"] += 1
        for triplet in triplets({places: pair.confidence for places, (pair, _) in found.items()}):
            pairs = list(itertools.combinations(triplet, 2))
            xy = tuple(matched.features(k).xy for k in triplet)
            own = tuple(found[pair][0].matches[: len(found[pair][0].matches) - found[pair][0].guided] for pair in pairs)
            vote = count_loops(own, xy).vote  # type: ignore[arg-type]
            for pair in pairs:
                counted[f"{'wrong' if wrong[pair] else 'right'} {np.sign(vote):+.0f}"] += 1


def main() -> None:
    """Read what is asked for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--houses", type=int, default=16)
    parser.add_argument("--twins", type=int, default=14)
    parser.add_argument("--work", type=Path, help="keeps what was matched; default: a temporary folder")
    asked = parser.parse_args()
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    with tempfile.TemporaryDirectory() as scratch:
        work = asked.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for number in range(asked.houses):
            measure(photographs(number, work, houses=1, pairs=3), work, counts, "houses")
            print(f"{number + 1} of {asked.houses} houses", flush=True)
        for number in range(asked.twins):
            measure(photographs(200 + number, work, houses=2, pairs=2), work, counts, "twins")
            print(f"{number + 1} of {asked.twins} twins", flush=True)
    for kind, counted in counts.items():
        print(kind)
        for which in ("wrong", "right"):
            out, kept = counted[f"{which} left out"], counted[which]
            votes = ", ".join(f"{counted[f'{which} {vote}']} {vote}" for vote in ("-1", "+0", "+1"))
            print(f"  {which} pairs: {out} of {out + kept} left out; votes of triplets: {votes}")


if __name__ == "__main__":
    main()
