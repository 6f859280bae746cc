"""What a collection adds to a pair, on scenes with known truth: matches along epipolar lines, and focal lengths.

    python benchmarks/relied_on.py [data/scenes/validation/FAMILY ...]    # rendered families

Matches the pairs of every set as `epiprior colmap` does. Prints how many of the matches of simple F are right, those
that F was estimated from and those gathered along its epipolar lines; and how many right and wrong F fall below each
share of inliers that an essential matrix keeps: `epiprior.collection.verify.MIN_CALIBRATED` is the highest at which no
right one does.
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.collection.run import MatchedCollection, match_collection
from epiprior.collection.store import MatchedPair
from epiprior.collection.verify import MIN_CALIBRATED, under_cameras
from epiprior.presets import DEFAULT
from epiprior_lab.evaluation.truth import TruthSettings, pair_truth
from epiprior_lab.labels.ground_truth import errors_px, label_matches
from epiprior_lab.pairsets import Pair, read_pair_set
from epiprior_lab.params import load_study

CONFIDENT = 0.5
RIGHT_PX = 10.0


@dataclass(frozen=True, kw_only=True)
class Found:
    """One pair that is relied on."""

    error_px: float
    calibrated: float
    simple: bool
    own: int
    own_right: int
    guided: int
    guided_right: int


def camera_of(known: Any) -> Any:
    """Return the camera of a pair as one of pycolmap."""
    import pycolmap

    (fx, _, cx), (_, fy, cy) = known.K[:2]
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", fx, known.width, known.height)
    camera.params = [fx, fy, cx + 0.5, cy + 0.5]
    return camera


def measure(pair: Pair, matched: MatchedCollection, places: tuple[int, int], one: MatchedPair) -> Found:
    """Compare with the truth."""
    truth = TruthSettings.of(load_study().truth)
    known, (f1, f2) = pair_truth(pair, truth), (matched.features(place) for place in places)
    rows1, rows2 = one.matches.T
    xy = f1.xy[rows1].astype(float), f2.xy[rows2].astype(float)
    right = label_matches(pair, *xy, f1.scale[rows1], f2.scale[rows2], settings=truth)
    own = len(right) - one.guided
    cameras = camera_of(pair.camera1), camera_of(pair.camera2)
    share = under_cameras(one, cameras, (f1.xy, f2.xy), max_image_size=DEFAULT.features.max_image_size).calibrated
    assert one.F is not None
    assert share is not None
    return Found(
        error_px=float(errors_px(one.F, known.x1, known.x2).mean()),
        calibrated=share,
        simple=one.input == "snn",
        own=own,
        own_right=int(right[:own].sum()),
        guided=one.guided,
        guided_right=int(right[own:].sum()),
    )


def match(pairs: tuple[Pair, ...]) -> list[Found]:
    """Match the pairs of a set, and measure those that are relied on and have a general geometry."""
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder, "pairs.txt")
        listed.write_text("".join(f"{pair.image1.name} {pair.image2.name}\n" for pair in pairs))
        images = [image for pair in pairs for image in (pair.image1, pair.image2)]
        matched = match_collection(images, pairs=str(listed))
        names = [image.name for image in matched.images.images]
        of = {pair.image1.name: pair for pair in pairs}
        return [
            measure(of[names[places[0]]], matched, places, one)
            for places, one in zip(matched.pairs, matched, strict=True)
            if one.geometry == "UNCALIBRATED" and one.confidence >= CONFIDENT
        ]


def main() -> None:
    """Read what is asked for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", type=Path, help="folders with a pairs.csv")
    sets = parser.parse_args().sets or sorted(Path("data/scenes/validation").iterdir())
    found = []
    for folder in sets:
        points = Path(str(folder).replace("scenes", "ground_truth")) / "control_points"
        found += match(read_pair_set(folder, points if points.is_dir() else None).pairs)
    right, wrong = ([f for f in found if (f.error_px < RIGHT_PX) is kind] for kind in (True, False))
    print(f"{len(found)} pairs relied on, {len(wrong)} of them wrong")
    simple = [f for f in right if f.simple]
    own, own_right, more, more_right = (
        sum(getattr(f, name) for f in simple) for name in ("own", "own_right", "guided", "guided_right")
    )
    print(f"simple and right F: {len(simple)}; of {own} matches {own_right / max(own, 1):.0%} are right,")
    print(f"  of {more} more along epipolar lines {more_right / max(more, 1):.0%}")
    print("share kept by an essential matrix: right F below it, wrong F below it")
    for limit in np.arange(0.5, 1.0, 0.05):
        below = [sum(f.calibrated < limit for f in kind) for kind in (right, wrong)]
        mark = "  <- MIN_CALIBRATED" if abs(limit - MIN_CALIBRATED) < 1e-9 else ""
        print(f"  {limit:.2f}  {below[0]:3d} of {len(right)}  {below[1]:3d} of {len(wrong)}{mark}")


if __name__ == "__main__":
    main()
