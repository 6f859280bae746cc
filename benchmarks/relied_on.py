"""What a collection adds to a pair, on scenes with known truth: matches along epipolar lines, and focal lengths.

    python benchmarks/relied_on.py [data/scenes/validation/FAMILY ...]    # rendered families

Matches the pairs of every set as `epiprior colmap` does, and image 1 of each with image 2 of the next, another place.
Prints how many pairs are relied on without focal lengths and with them, and for how many of these the camera is turned
and moved as it should be; and how many of the matches of simple F are right, those that F was estimated from and those
gathered along its epipolar lines.
"""

import argparse
import itertools
import tempfile
from collections import Counter
from pathlib import Path

from epiprior.collection.run import MatchedCollection, match_collection
from epiprior.collection.store import MatchedPair
from epiprior.collection.verify import CONTRADICTS, judge_pairs
from epiprior_lab.bags.methods import true_camera
from epiprior_lab.evaluation.distances import pose_errors
from epiprior_lab.labels.ground_truth import label_matches
from epiprior_lab.pairsets import Pair, read_pair_set
from epiprior_lab.params import load_study

CONFIDENT = 0.5
RIGHT_DEG = 10.0


def outcome(pair: Pair | None, matched: MatchedCollection, places: tuple[int, int], found: MatchedPair) -> str:
    """Return whether a pair that is relied on is right: its camera, or its plane."""
    if found.F is None or found.geometry not in ("CALIBRATED", "UNCALIBRATED"):
        return "one plane"
    if pair is None:
        return "another place"
    xy = [matched.features(place).xy[rows].astype(float) for place, rows in zip(places, found.matches.T, strict=True)]
    assert pair.camera1 is not None
    assert pair.camera2 is not None
    worst = max(pose_errors(found.F, (pair.camera1, pair.camera2), *xy))
    return "right" if worst < RIGHT_DEG else "wrong"


def count_matches(pair: Pair, matched: MatchedCollection, places: tuple[int, int], found: MatchedPair) -> Counter[str]:
    """Count the right matches of a simple F."""
    f1, f2 = (matched.features(place) for place in places)
    rows1, rows2 = found.matches.T
    truth = load_study().truth
    xy = f1.xy[rows1].astype(float), f2.xy[rows2].astype(float)
    right = label_matches(pair, *xy, f1.scale[rows1], f2.scale[rows2], settings=truth)
    own = len(right) - found.guided
    return Counter(own=own, own_right=int(right[:own].sum()), more=found.guided, more_right=int(right[own:].sum()))


def measure(pairs: tuple[Pair, ...]) -> tuple[Counter[tuple[str, str]], Counter[str]]:
    """Match the pairs of a set, and pairs of its images that show different places."""
    outcomes: Counter[tuple[str, str]] = Counter()
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        apart = [(a.image1, b.image2) for a, b in itertools.pairwise([*pairs, pairs[0]])]
        listed = Path(folder, "pairs.txt")
        own = [(pair.image1, pair.image2) for pair in pairs]
        listed.write_text("".join(f"{a.name} {b.name}\n" for a, b in own + apart))
        cameras = {pair.image1.name: true_camera(pair.camera1) for pair in pairs if pair.camera1}
        cameras |= {pair.image2.name: true_camera(pair.camera2) for pair in pairs if pair.camera2}
        matched = match_collection([image for both in own for image in both], pairs=str(listed), cameras=cameras)
        names = [image.name for image in matched.images.images]
        of = {(pair.image1.name, pair.image2.name): pair for pair in pairs}
        for how, collection in (("without", matched.plain), ("with", matched)):
            for places, (found, why_not) in zip(matched.pairs, judge_pairs(collection, CONFIDENT), strict=True):
                pair = of.get((names[places[0]], names[places[1]]))
                if not why_not:
                    outcomes[how, outcome(pair, matched, places, found)] += 1
                elif why_not == CONTRADICTS:
                    outcomes[how, "contradicts"] += 1
                if pair and how == "without" and found.input == "snn" and outcomes and not why_not:
                    counts += count_matches(pair, matched, places, found)
    return outcomes, counts


def main() -> None:
    """Read what is asked for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", type=Path, help="folders with a pairs.csv")
    sets = parser.parse_args().sets or sorted(Path("data/scenes/validation").iterdir())
    outcomes: Counter[tuple[str, str]] = Counter()
    counts: Counter[str] = Counter()
    total = 0
    for folder in sets:
        points = Path(str(folder).replace("scenes", "ground_truth")) / "control_points"
        pairs = read_pair_set(folder, points if points.is_dir() else None).pairs
        found, of_matches = measure(pairs)
        outcomes, counts, total = outcomes + found, counts + of_matches, total + len(pairs)
    print(f"{total} pairs, and as many of different places; relied on")
    for how in ("without", "with"):
        kinds = ", ".join(f"{n} {kind}" for (own, kind), n in sorted(outcomes.items()) if own == how)
        print(f"  {how} focal lengths: {kinds}")
    print(f"simple F: of {counts['own']} matches {counts['own_right'] / max(counts['own'], 1):.0%} are right,")
    print(f"  of {counts['more']} more along epipolar lines {counts['more_right'] / max(counts['more'], 1):.0%}")


if __name__ == "__main__":
    main()
