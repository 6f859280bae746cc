"""What becomes of focal lengths while few photographs are mapped, on rendered houses with known cameras.

    python benchmarks/focal_lengths.py [--houses 15] [--work FOLDER]

Every second house is of the family facades-easy, the others of facades-hard, with seeds of their own. Six photographs
of each are matched as `epiprior sfm` does, and ten bags of 3 to 6 of them are mapped; geometries are always those of
unknown focal lengths. Where these are not known: refined all the time, as COLMAP does; as `epiprior sfm` does; with the
median of what pairs tell, refined last. Where they are known, exactly or within 5 % (standard deviation): refined all
the time, last, which is what `epiprior sfm` does, or never, which it does for `--camera-params`.
"""

import argparse
import itertools
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from epiprior.collection import model
from epiprior.collection.database import CameraSettings, infer_cameras, write_database
from epiprior.collection.run import match_collection
from epiprior.collection.verify import judge_pairs
from epiprior_lab.bags.choose import View
from epiprior_lab.bags.measure import judge
from epiprior_lab.bags.params import PATH, load_sfm_params
from epiprior_lab.bags.twins import render_house

FAMILIES = ("facades-easy", "facades-hard")
BAGS = {3: 3, 4: 3, 5: 3, 6: 1}
CONFIDENT, NOISE = 0.5, 0.05
MAPPER = load_sfm_params(PATH).mapper
Outcomes = dict[tuple[str, str, int], list[tuple[int, int, int, float]]]


def photographs(number: int, folder: Path) -> dict[str, View]:
    """Render the photographs of a house, and return them by name."""
    how = {"family": FAMILIES[number % 2], "style_seed": 9000 + number, "seed": 7000 + number}
    house = render_house(name=f"house {number}", pairs=3, jpeg_quality=92, **how)  # type: ignore[arg-type]
    views = {
        f"{number}-{k}.jpg": View(image=folder / f"{number}-{k}.jpg", camera=c, place="")
        for k, (_, c) in enumerate(house)
    }
    for view, (jpeg, _) in zip(views.values(), house, strict=True):
        view.image.write_bytes(jpeg)
    return views


def measure(bag: dict[str, View], work: Path, rng: np.random.Generator, outcomes: Outcomes) -> None:
    """Map a bag in every way."""
    matched = match_collection([view.image for view in bag.values()], work=work)
    database, median, out = work / "bag.db", work / "median.db", work / "sparse"

    def fill(error: float | None = None, *, prior: bool = False) -> None:
        database.unlink(missing_ok=True)
        cameras = infer_cameras(matched.images, CameraSettings())
        for name, camera in cameras:
            camera.has_prior_focal_length = prior
            if error is not None:
                camera.focal_length = bag[name].camera.K[0, 0] * (1 + error * rng.normal())
        write_database(database, judge_pairs(matched, CONFIDENT), cameras)

    def note(known: str, how: str, found: list[model.Model]) -> None:
        of = judge(found[0] if found else None, bag, MAPPER)
        outcomes[known, how, min(len(bag), 5)].append((of["images"], of["registered"], of["wrong"], of["accuracy"]))

    fill()
    note("unknown", "refined always", model.map_once(database, work, out, 0, refine=True))
    note("unknown", "epiprior sfm", model.map_database(database, work, out))
    if model.copy_with_median(database, median, 0):
        note("unknown", "median, refined last", model.map_database(median, work, out))
    for known, error in (("exact", 0.0), ("within 5 %", NOISE)):
        state = rng.bit_generator.state
        fill(error)
        note(known, "refined always", model.map_once(database, work, out, 0, refine=True))
        rng.bit_generator.state = state  # the same errors
        fill(error, prior=True)
        note(known, "refined last", model.map_database(database, work, out))
        note(known, "refined never", model.map_database(database, work, out, refine=False))


def main() -> None:
    """Read what is asked for, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--houses", type=int, default=15)
    parser.add_argument("--work", type=Path, help="keeps what was matched; default: a temporary folder")
    asked = parser.parse_args()
    outcomes: Outcomes = defaultdict(list)
    with tempfile.TemporaryDirectory() as scratch:
        work = asked.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for number in range(asked.houses):
            views, rng = photographs(number, work), np.random.default_rng([20, number])
            match_collection([view.image for view in views.values()], work=work)
            for size, count in BAGS.items():
                choices = list(itertools.combinations(views, size))
                for chosen in rng.permutation(len(choices))[:count]:
                    measure({name: views[name] for name in choices[chosen]}, work, rng, outcomes)
            print(f"{number + 1} of {asked.houses} houses", flush=True)
    print("focal lengths  mapped                bags of  bags  right (wrong) of  accuracy")
    for (known, how, size), found in sorted(outcomes.items()):
        images, registered, wrong, accuracy = np.array(found).T
        right = f"{registered.sum() - wrong.sum():.0f} ({wrong.sum():.0f}) of {images.sum():.0f}"
        bags = f"{'5, 6' if size == 5 else size:>7} {len(found):5d}"
        print(f"{known:14s} {how:21s} {bags}  {right:>16s}  {accuracy.mean():8.3f}")


if __name__ == "__main__":
    main()
