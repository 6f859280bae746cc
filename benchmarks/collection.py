"""A large collection: seconds per stage, memory, what retrieval finds, and whether workers change anything.

    python benchmarks/collection.py data/scenes/test/facades-easy [--images 1000] [--width 640] [--cluster]

The photographs of pair sets are turned, cropped and relit until there are enough, so that it is known which show one
scene. The collection is matched (`similar:20`, cascade) and a database is written. With `--cluster` all is matched
again, by two workers of a dask cluster of which one is killed on the way, and the databases are compared row by row.
Last, the first of the images are matched by one worker and by two. Give the machine nothing else to do: seconds are of
the clock, and of processors.
"""

import argparse
import contextlib
import os
import resource
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
from distributed import LocalCluster

from epiprior.collection.database import CameraSettings, infer_cameras, write_database
from epiprior.collection.run import MatchedCollection, match_collection
from epiprior.collection.verify import judge_pairs
from epiprior_lab.pairsets import read_pair_set

Progress = Callable[[str, int, int], None]
CONFIDENT = 0.5
KILLED_AFTER = 0.3  # of the pairs


def make_images(roots: Sequence[Path], count: int, width: int, folder: Path) -> dict[str, str]:
    """Write `count` JPEG files, as many of every photograph, and return which scene each shows."""
    pairs = [pair for root in roots for pair in read_pair_set(root).pairs]
    photographs = [
        (pair.pair_id, side, image) for pair in pairs for side, image in ((1, pair.image1), (2, pair.image2))
    ]
    folder.mkdir(parents=True)
    scenes = {}
    for number in range(count):
        scene, side, image = photographs[number % len(photographs)]
        rng = np.random.default_rng([number, 20])
        name = f"{scene}_{side}_{number // len(photographs):02d}.jpg"
        pixels = cv2.imread(str(image))
        size = width, width * pixels.shape[0] // pixels.shape[1]
        centre = pixels.shape[1] / 2, pixels.shape[0] / 2
        # A similarity that keeps at least four fifths of the picture, brightness and contrast.
        turn = rng.uniform(-20, 20) + 90 * rng.integers(0, 4) * (number >= len(photographs))
        M = cv2.getRotationMatrix2D(centre, turn, width / pixels.shape[1] * rng.uniform(1.0, 1.25))
        M[:, 2] += np.array(size) / 2 - centre + width / 640 * rng.uniform(-30, 30, 2)
        changed = cv2.warpAffine(pixels, M, size, flags=cv2.INTER_AREA)
        changed = 255 * (changed / 255) ** rng.uniform(0.7, 1.4) * rng.uniform(0.75, 1.0)
        cv2.imwrite(str(folder / name), np.rint(changed).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 92])
        scenes[name] = scene
    return scenes


def processor_seconds() -> float:
    """Return what this process has used, its workers, and those that ended."""
    living = (child.cpu_times() for child in psutil.Process().children(recursive=True))
    return sum(os.times()[:4]) + sum(one.user + one.system for one in living)


class Clock:
    """Seconds of the clock and of processors from one stage to the next, by what `match_collection` reports."""

    def __init__(self) -> None:
        self.last, self.used = time.perf_counter(), processor_seconds()
        self.seconds: dict[str, float] = {}
        self.processors: dict[str, float] = {}
        self.told = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Take note of progress; print a line a minute."""
        now = time.perf_counter()
        if now - self.told > 60:
            self.told = now
            print(f"    {stage}: {done} of {total}", flush=True)
        if stage == "pairs" and "retrieval" not in self.seconds:
            self.stop("retrieval")  # and the first pair
        if done == total:
            self.stop(stage)

    def stop(self, stage: str) -> None:
        """End a stage."""
        now, used = time.perf_counter(), processor_seconds()
        self.seconds[stage], self.last = now - self.last, now
        self.processors[stage], self.used = used - self.used, used


def rows(database: Path) -> list[str]:
    """Return all that a database holds."""
    with contextlib.closing(sqlite3.connect(database)) as opened:
        return list(opened.iterdump())


def match(images: Path | Sequence[Path], out: Path, progress: Progress, clock: Clock, **how: Any) -> MatchedCollection:
    """Match a collection and write its database, `out` with the suffix .db."""
    matched = match_collection(images, pairs="similar:20", work=out, on_progress=progress, **how)
    write_database(
        out.with_suffix(".db"), judge_pairs(matched, CONFIDENT), infer_cameras(matched.images, CameraSettings())
    )
    clock.stop("database")
    return matched


def tell(matched: MatchedCollection, scenes: dict[str, str], clock: Clock) -> None:
    """Print what was found, and what it cost."""
    names = [image.name for image in matched.images.images]
    sizes = np.unique([scenes[name] for name in names], return_counts=True)[1]
    shown = int((sizes * (sizes - 1) // 2).sum())
    same = sum(scenes[names[a]] == scenes[names[b]] for a, b in matched.pairs)
    print(f"  {len(names)} images of {len(sizes)} scenes, {len(matched)} pairs of {len(names) * (len(names) - 1) // 2}")
    print(f"  of {shown} pairs of one scene {same / max(shown, 1):.1%} are chosen, of two scenes {len(matched) - same}")
    kinds = Counter(
        (pair.geometry or "none", scenes[pair.image1] == scenes[pair.image2])
        for pair in matched
        if pair.confidence >= CONFIDENT
    )
    for (geometry, of_one), count in sorted(kinds.items()):
        print(f"  {count} pairs of {'one scene' if of_one else 'two scenes'} are {geometry}")
    for stage, seconds in clock.seconds.items():
        print(f"  {stage:10s} {seconds:8.1f} s, {clock.processors[stage]:8.1f} s of processors")
    own, worker = (
        resource.getrusage(who).ru_maxrss / 2**20 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    print(f"  peak memory: the command {own:.2f} GiB, the largest worker {worker:.2f} GiB")


def survive(images: Path | Sequence[Path], out: Path, expected: list[str]) -> None:
    """Match all on a dask cluster of two, one of them killed on the way, and print whether the rows are the same."""
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        victim = next(iter(cluster.workers.values()))
        clock, done = Clock(), threading.Event()

        def progress(stage: str, count: int, total: int) -> None:
            clock(stage, count, total)
            if stage == "pairs" and count > KILLED_AFTER * total and not done.is_set():
                done.set()
                victim.process.process.kill()

        match(images, out / "cluster", progress, clock, scheduler=cluster.scheduler_address)
    told = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in clock.seconds.items())
    print(f"  a cluster of two, one of them killed: {told}; same rows: {rows(out / 'cluster.db') == expected}")


def compare(images: Sequence[Path], out: Path) -> None:
    """Print seconds by one worker and by two, and whether the rows are the same."""
    seconds, held = {}, {}
    for workers in (1, 2):
        clock = Clock()
        match(images, out / f"by-{workers}", clock, clock, workers=workers)
        seconds[workers], held[workers] = clock.seconds, rows(out / f"by-{workers}.db")
        told = ", ".join(f"{stage} {taken:.1f} s" for stage, taken in clock.seconds.items())
        print(f"  {len(images)} images, workers {workers}: {told}")
    one, two = (sum(seconds[workers][stage] for stage in ("features", "pairs")) for workers in (1, 2))
    same = held[1] == held[2]
    print(f"  features and pairs by two workers {one / two:.2f} times as fast as by one; same rows: {same}")


def main() -> None:
    """Read what is asked for, and do it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", type=Path, help="folders with a pairs.csv")
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--width", type=int, default=640, help="of every image, pixels")
    parser.add_argument("--compare", type=int, default=40, help="so many of them by one worker and by two; 0: none")
    parser.add_argument("--cluster", action="store_true", help="all again on a dask cluster that loses a worker")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="a new folder that is kept; default: a temporary one")
    asked = parser.parse_args()
    with contextlib.ExitStack() as stack:
        run(asked, asked.out or Path(stack.enter_context(tempfile.TemporaryDirectory())))


def run(asked: argparse.Namespace, out: Path) -> None:
    """Make the images below `out`, match them by processes and by a cluster, compare."""
    images, clock = out / "images", Clock()
    scenes = make_images(asked.sets, asked.images, asked.width, images)
    tell(match(images, out / "all", clock, clock, workers=asked.workers), scenes, clock)
    if asked.cluster:
        survive(images, out, rows(out / "all.db"))
    if asked.compare:
        compare(sorted(images.iterdir())[: asked.compare], out)


if __name__ == "__main__":
    main()
