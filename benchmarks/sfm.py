"""Structure from motion on bags of photographs with known cameras: COLMAP as it comes, snn, epiprior, mapped alike.

    python benchmarks/sfm.py DATA [--sets strecha ...] [--sizes 5 10] [--bags 2] [--methods colmap snn cascade]

DATA holds pair sets. A bag grows over their pairs: from a random photograph of a scene, by one that is paired with one
in the bag. All methods share pycolmap's mapper (one thread, fixed seed), once with known and once with inferred
intrinsics. `colmap`: pycolmap's SIFT, exhaustive matching and verification. `snn`: epiprior's features, mutual nearest
neighbours below a ratio, COLMAP's verification. `cascade`, `preprocess`: epiprior. Measures, of the model with most
photographs: how many are registered; how many of these are wrong (their median error to the others is above 10
degrees); accuracy, the mean over 1 to 10 degrees of the share of pairs of the bag below that error, the larger of the
errors of rotation and direction, where what is not registered counts as wrong; seconds of processor time, of features
and matching and of mapping. One row per bag, method and kind of intrinsics goes to OUT.
"""

import argparse
import csv
import itertools
import os
import statistics
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from epiprior.collection.database import CameraSettings, infer_cameras, write_database
from epiprior.collection.model import Model, map_database
from epiprior.collection.run import match_collection
from epiprior.io.colmap import add_pair
from epiprior.matching.baselines import snn_matches
from epiprior.types import FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.pairsets import Camera, read_pair_set

SEED = 0
WRONG_DEG = 10.0
Bag = dict[str, tuple[Path, Camera]]  # by the name in the bag


def bags_of(root: Path, size: int, count: int) -> dict[str, Bag]:
    """Return up to `count` different bags of every scene with cameras that has so many photographs."""
    near: dict[str, dict[Path, set[Path]]] = defaultdict(lambda: defaultdict(set))
    cameras: dict[Path, Camera] = {}
    for pair in read_pair_set(root).pairs:
        if pair.camera1 is not None and pair.camera2 is not None:
            near[pair.scene][pair.image1].add(pair.image2)
            near[pair.scene][pair.image2].add(pair.image1)
            cameras |= {pair.image1: pair.camera1, pair.image2: pair.camera2}
    found: dict[str, Bag] = {}
    for scene, neighbours in sorted(near.items()):
        seen = set()
        for number in range(count):
            rng = np.random.default_rng(child_seed(SEED, f"sfm-{size}-{number}", f"{root.name}/{scene}"))
            bag = [sorted(neighbours)[rng.integers(len(neighbours))]]
            while len(bag) < size and (around := sorted(set().union(*(neighbours[one] for one in bag)) - set(bag))):
                bag.append(around[rng.integers(len(around))])
            if len(bag) == size and frozenset(bag) not in seen:
                seen.add(frozenset(bag))
                named = {f"{k:02}{one.suffix.lower()}": (one, cameras[one]) for k, one in enumerate(sorted(bag))}
                found[f"{root.name}/{scene}/{size}/{number}"] = named
    return found


def by_colmap(images: Path, database: Path) -> None:
    """Fill a database as COLMAP does."""
    import pycolmap

    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    verification = pycolmap.TwoViewGeometryOptions()
    extraction.use_gpu = matching.use_gpu = False
    extraction.num_threads = matching.num_threads = 1
    verification.ransac.random_seed = SEED
    mode = pycolmap.CameraMode.PER_IMAGE
    pycolmap.extract_features(database, images, camera_mode=mode, extraction_options=extraction)
    pycolmap.match_exhaustive(database, matching_options=matching, verification_options=verification)


def by_snn(images: Path, database: Path) -> None:
    """Fill a database with nearest neighbours of epiprior's features, verified by COLMAP."""
    import pycolmap

    found = match_collection(images, mode="standard", pairs="sequential:1", workers=1)  # for the features
    write_database(database, found, infer_cameras(found.images, CameraSettings()), 2.0)
    names = [image.name for image in found.images.images]
    pairs = list(itertools.combinations(range(len(names)), 2))
    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        for a, b in pairs:
            matches = snn_matches(None, None, features1=found.features(a), features2=found.features(b)).one_to_one()
            rows = np.column_stack([matches.feature1, matches.feature2])
            add_pair(opened, (ids[names[a]], ids[names[b]]), rows)
    listed = database.with_suffix(".txt")
    listed.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in pairs), encoding="utf-8")
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = SEED
    pycolmap.verify_matches(database, listed, options=options)


def by_epiprior(mode: str) -> Callable[[Path, Path], None]:
    """Return what fills a database with epiprior's geometries."""

    def fill(images: Path, database: Path) -> None:
        found = match_collection(images, mode=mode, workers=1)
        write_database(database, found, infer_cameras(found.images, CameraSettings()), 0.5)

    return fill


METHODS = {"colmap": by_colmap, "snn": by_snn} | {mode: by_epiprior(mode) for mode in ("cascade", "preprocess")}


def know_cameras(database: Path, bag: Bag) -> None:
    """Put the true intrinsics into a database."""
    import pycolmap

    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            truth = bag[image.name][1]
            (fx, _, cx), (_, fy, cy) = truth.K[:2]
            camera = pycolmap.Camera.create_from_model_name(image.camera_id, "PINHOLE", fx, truth.width, truth.height)
            camera.params, camera.has_prior_focal_length = [fx, fy, cx + 0.5, cy + 0.5], True
            opened.update_camera(camera)


def angle_deg(cosine: float) -> float:
    """Return the angle of a cosine, degrees."""
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def errors_of(model: Model | None, bag: Bag) -> dict[tuple[str, str], float]:
    """Return the error of each pair of the bag, degrees; 180 where one is not registered."""
    placed = (
        {} if model is None else dict(zip(model.seen, zip(model.rotations, model.centres, strict=True), strict=True))
    )
    errors = {}
    for a, b in itertools.combinations(sorted(bag), 2):
        (true1, true2), errors[a, b] = (bag[a][1], bag[b][1]), 180.0
        if a in placed and b in placed:
            (R1, c1), (R2, c2) = placed[a], placed[b]
            turn = angle_deg((np.trace((R2 @ R1.T).T @ (true2.R @ true1.R.T)) - 1) / 2)
            ways: list[FloatArray] = [R1 @ (c2 - c1), true1.R @ (true2.centre - true1.centre)]
            lengths = [float(np.linalg.norm(way)) for way in ways]
            errors[a, b] = max(turn, angle_deg(float(ways[0] @ ways[1]) / max(lengths[0] * lengths[1], 1e-12)))
    return errors


def processor_seconds() -> float:
    """Return the seconds that this process has used, and its children that ended."""
    return sum(os.times()[:4])


def measure(bag: Bag, method: str) -> Iterator[dict[str, str | float]]:
    """Match a bag, map it with inferred and with known intrinsics, and measure both models."""
    with tempfile.TemporaryDirectory() as scratch:
        images, database = Path(scratch, "images"), Path(scratch, "database.db")
        images.mkdir()
        for name, (path, _) in bag.items():
            (images / name).symlink_to(path.resolve())
        start = processor_seconds()
        METHODS[method](images, database)
        matching = processor_seconds() - start
        for kind in ("inferred", "known"):
            if kind == "known":
                know_cameras(database, bag)
            start = processor_seconds()
            models = map_database(database, images, Path(scratch, "sparse"), seed=SEED, refine=kind == "inferred")
            errors = errors_of(models[0] if models else None, bag)
            registered = list(models[0].seen) if models else []
            of_image = [[e for pair, e in errors.items() if name in pair and e < 180.0] for name in registered]
            yield {
                "method": method,
                "intrinsics": kind,
                "images": len(bag),
                "registered": len(registered),
                "wrong": sum(statistics.median(e) > WRONG_DEG for e in of_image if e),
                "accuracy": statistics.fmean(np.mean([e < d for e in errors.values()]) for d in range(1, 11)),
                "matching_s": matching,
                "mapping_s": processor_seconds() - start,
            }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, write the rows, print the means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--sets", nargs="*", default=[])
    parser.add_argument("--sizes", nargs="*", type=int, default=[5, 10])
    parser.add_argument("--bags", type=int, default=2)
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=list(METHODS))
    parser.add_argument("--out", type=Path, default=Path("sfm.csv"))
    given = parser.parse_args(arguments)
    roots = [given.data / name for name in given.sets] or sorted(path.parent for path in given.data.glob("*/pairs.csv"))
    bags: dict[str, Bag] = {}
    for root, size in itertools.product(roots, given.sizes):
        bags |= bags_of(root, size, given.bags)
    rows: list[dict[str, str | float]] = []
    for (name, bag), method in itertools.product(bags.items(), given.methods):
        for row in measure(bag, method):
            rows.append({"bag": name} | row)
            print(rows[-1], file=sys.stderr, flush=True)
    with given.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print("| method | intrinsics | registered | wrong | accuracy |\n|---|---|---:|---:|---:|")
    for method, kind in itertools.product(given.methods, ("known", "inferred")):
        mine = [row for row in rows if (row["method"], row["intrinsics"]) == (method, kind)]
        total = {key: sum(float(row[key]) for row in mine) for key in ("images", "registered", "wrong", "accuracy")}
        shown = f"{total['registered']:.0f} of {total['images']:.0f} | {total['wrong']:.0f}"
        print(f"| {method} | {kind} | {shown} | {total['accuracy'] / len(mine):.3f} |")


if __name__ == "__main__":
    main()
