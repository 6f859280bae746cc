"""Stage `sfm`: structure from motion on bags of photographs; measures, tables, a figure and a page in one.

What is matched and mapped is kept by bag and method, so that a run that was killed goes on. Seconds go to `timings`.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from epiprior_lab.bags.choose import PLAIN, TWINS, Bag, View, difficulty, plain_bags, stranger_bags
from epiprior_lab.bags.learned import match_bag
from epiprior_lab.bags.measure import BagRecord, measure_bag
from epiprior_lab.bags.methods import MODES
from epiprior_lab.bags.params import PATH, SfmParams, TwinParams, load_sfm_params
from epiprior_lab.bags.twins import render_house
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks, single_threaded
from epiprior_lab.evaluation import learned, peers
from epiprior_lab.evaluation.protocol import MODELS
from epiprior_lab.evaluation.records import read_table
from epiprior_lab.evaluation.sets import FOLDER
from epiprior_lab.pairsets import read_pair_set
from epiprior_lab.params import read_arguments
from epiprior_lab.report.bags import write_bag_report

RENDERED = Path("data/sfm-twins")
SHARES = Path("reports/real/tables/pairs.csv")
STORE = Path("data/.tasks/sfm")


def twin_bags(params: TwinParams) -> list[Bag]:
    """Render twin houses into a folder, and return a bag for each two."""
    common = {"family": params.family, "pairs": params.pairs, "jpeg_quality": params.jpeg_quality}
    tasks = []
    for style in range(params.styles):
        shared = child_seed(params.seed, "style", f"{style}")
        for name in (f"{style:02}a", f"{style:02}b"):
            own = {"name": name, "style_seed": shared, "seed": child_seed(params.seed, "house", name)}
            tasks.append(Task(name=name, payload={**own, **common}))
    houses = map_tasks(render_house, tasks, description="render twins", store=STORE)
    RENDERED.mkdir(parents=True, exist_ok=True)
    views: dict[str, list[View]] = defaultdict(list)
    for task, house in zip(tasks, houses, strict=True):
        for number, (jpeg, camera) in enumerate(house):
            image = RENDERED / f"{task.name}{number}.jpg"
            image.write_bytes(jpeg)
            views[task.name[:-1]].append(View(image=image, camera=camera, place=task.name))
    about: dict[str, Any] = {"group": "twins", "kind": TWINS, "number": 0}
    return [Bag(scene=s, size=len(own), views=tuple(own), **about) for s, own in views.items()]


def match_learned_bags(bags: Sequence[Bag], peer: str) -> Mapping[str, dict[str, Any]]:
    """Return what a learned matcher found on each bag, by name; nothing where its environment is not present."""
    if not (peers.ENVIRONMENT / "bin" / "python").is_file():
        return {}
    how = {"peer": peer, "python": peers.interpreter(), "script": learned.SCRIPT}
    files = (learned.SCRIPT, peers.REQUIREMENTS, peers.WEIGHTS)
    tasks = []
    for bag in bags:
        images = tuple(view.image for view in bag.views)
        tasks.append(Task(name=f"{bag.name} {peer}", payload={"images": images, **how}, files=(*images, *files)))
    found = map_tasks(match_bag, tasks, versions=False, description=f"match bags, {peer}", store=STORE)
    return {bag.name: {"learned": one, "learned_s": used} for bag, (one, used) in zip(bags, found, strict=True)}


def measure_bags(bags: Sequence[Bag], params: SfmParams) -> list[BagRecord]:
    """Return the records of all bags by every method that is present."""
    models = tuple(sorted(path for path in MODELS.rglob("*") if path.suffix in (".json", ".onnx")))
    cases: list[tuple[Bag, str, dict[str, Any]]] = [(bag, name, {}) for bag in bags for name in params.methods.names]
    kinds, sizes = params.methods.learned_kinds, params.methods.learned_sizes
    for peer in params.methods.learned or ():
        own = [bag for bag in bags if bag.kind in kinds and (bag.kind != PLAIN or bag.size in sizes)]
        found = match_learned_bags(own, peer)
        cases += [(bag, peer, found[bag.name]) for bag in own if bag.name in found]
    tasks = []
    for bag, name, matches in cases:
        files = (*(view.image for view in bag.views), *(models if name in MODES else ()))
        payload = {"bag": bag, "method": name, "mapper": params.mapper, **matches}
        tasks.append(Task(name=f"{bag.name} {name}", payload=payload, files=files))
    done = map_tasks(measure_bag, tasks, description="map bags", store=STORE)
    return [record for records in done for record in records]


def main() -> None:
    """Write ``data/sfm-twins``, and in ``<out>`` tables, figures, timings and ``performance.md``."""
    arguments = read_arguments(main.__doc__, params=PATH, out=Path("reports/sfm"))
    params = load_sfm_params(arguments.params)
    sets = {name: read_pair_set(FOLDER / name).pairs for name in params.bags.groups}
    known = read_table(SHARES, "group pair_id right_share").dropna(subset="right_share")
    of_pair = {(row["group"], row["pair_id"]): float(row["right_share"]) for row in known.to_dict("records")}
    shares = {(p.image1, p.image2): of_pair[g, p.pair_id] for g in sets for p in sets[g] if (g, p.pair_id) in of_pair}
    plain = plain_bags(sets, params.bags)
    bags = [*plain, *stranger_bags(plain, sets, params.bags), *twin_bags(params.twins)]
    records = pd.DataFrame([asdict(record) for record in measure_bags(bags, params)])
    limits = {"easy": params.report.easy_share, "hard": params.report.hard_share}
    records.insert(4, "difficulty", records["bag"].map({bag.name: difficulty(bag, shares, **limits) for bag in bags}))
    methods = [*params.methods.names, *(params.methods.learned or ())]
    with single_threaded():
        write_bag_report(records, methods, params.report, arguments.out)


if __name__ == "__main__":
    main()
