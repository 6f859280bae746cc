"""Time of every step, against the baseline pipeline, and over the number of features, with peak memory.

    python benchmarks/speed.py IMAGE1 IMAGE2 [IMAGE1 IMAGE2 ...] [--repeats 5] [--sizes 1000 4000 16000]

The baseline is SIFT, standard matches X_L and the same estimator. Ratios are medians of runs that alternate in one
process; absolute seconds depend on the machine and on what else it does.
"""

import argparse
import multiprocessing
import resource
import statistics
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

import epiprior
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.presets import PRESETS, FeatureSettings, PreprocessSettings


def time_pair(image1: str, image2: str, estimator: str, repeats: int) -> None:
    """Print the steps of one pair under both presets beside the baseline."""
    print(f"\n{Path(image1).name} and {Path(image2).name}, estimator {estimator}, median of {repeats} runs")
    for preset in PRESETS:
        steps, whole, ratio = defaultdict(list), [], []
        for run in range(repeats + 1):
            start = time.perf_counter()
            epiprior.estimate_fundamental(image1, image2, estimator=estimator, mode="standard")
            middle = time.perf_counter()
            ranked = epiprior.rank_matches(image1, image2, preset=preset)
            ranked_at = time.perf_counter()
            epiprior.estimate_fundamental(image1, image2, estimator=estimator, preset=preset, ranked=ranked)
            end = time.perf_counter()
            if run == 0:
                continue  # compiles, loads the model, fills caches
            for name, seconds in ranked.seconds.items():
                steps[name].append(seconds)
            base = ranked.seconds["features"] + ranked.seconds["standard matches"]
            whole.append(ranked_at - middle - base)
            ratio.append((end - middle) / (middle - start))
        print(f"  preset {preset}, {len(ranked.sets)} roll hypotheses, {len(ranked.sets[0])} matches")
        for name, seconds in steps.items():
            print(f"    {name:24s} {statistics.median(seconds):7.3f} s")
        print(f"    {'beyond standard matches':24s} {statistics.median(whole):7.3f} s")
        print(f"    {'with / without ours':24s} {statistics.median(ratio):7.2f}")


def _blobs(side: int) -> np.ndarray:
    """Return a picture that is full of features: Gaussian blobs of four sizes, on 1536 px more than 20,000."""
    rng = np.random.default_rng(0)
    image = np.full((side, side), 128.0, np.float32)
    for sigma in (1.6, 2.5, 4.0, 6.5):
        count = int((side / (7 * sigma)) ** 2)
        dots = np.zeros_like(image)
        dots[rng.integers(0, side, count), rng.integers(0, side, count)] = rng.uniform(-750, 750, count) * sigma**2
        image += cv2.GaussianBlur(dots, (0, 0), sigma)
    return np.clip(image, 0, 255).astype(np.uint8)


def _one_size(count: int, queue: multiprocessing.Queue) -> None:
    image = _blobs(1536)
    turn = cv2.getRotationMatrix2D((768, 768), 5, 1.05)
    other = cv2.warpAffine(image, turn, image.shape[::-1], flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT)
    settings = PreprocessSettings(name="default", features=FeatureSettings(max_keypoints=count, max_image_size=2048))
    seconds = 0.0
    for _ in range(2):  # the first call compiles
        start = time.perf_counter()
        ranked = epiprior.rank_matches(image, other, settings=settings)
        seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    found = len(detect_features(load_photograph(image, 2048), settings.features))
    queue.put((found, len(ranked.sets[0]), seconds, peak))


def time_sizes(sizes: list[int]) -> None:
    """Print time and peak memory over the number of features, each in a process of its own."""
    print("\n allowed  features   matches   seconds   peak memory")
    context = multiprocessing.get_context("spawn")
    for count in sizes:
        queue = context.Queue()
        process = context.Process(target=_one_size, args=(count, queue))
        process.start()
        found, matches, seconds, peak = queue.get()
        process.join()
        print(f"{count:8d} {found:9d} {matches:9d} {seconds:8.2f} s {peak:9.2f} GiB")


def main() -> None:
    """Parse arguments and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", help="paths, two per pair")
    parser.add_argument("--estimator", default="usac")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--sizes", type=int, nargs="*", default=[1000, 2000, 4000, 8000, 16000])
    options = parser.parse_args()
    if len(options.images) % 2:
        parser.error("images come in pairs")
    for image1, image2 in zip(options.images[::2], options.images[1::2], strict=True):
        time_pair(image1, image2, options.estimator, options.repeats)
    time_sizes(options.sizes)


if __name__ == "__main__":
    main()
