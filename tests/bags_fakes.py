"""Made-up sets, parameters and records of the benchmark on bags of photographs."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from epiprior_lab.bags.params import PATH, BagParams, load_sfm_params
from epiprior_lab.pairsets import Camera, Pair
from worlds import camera_pair

COMMITTED = load_sfm_params(Path(__file__).parents[1] / PATH)
BAGS = BagParams(seed=1, groups=("long",), per_scene={3: 2, 5: 1}, stranger_size=5)
PARAMS = replace(COMMITTED, bags=BAGS, report=replace(COMMITTED.report, seed=0, bootstrap_draws=200, sizes=(3, 5)))
K = np.array([[500.0, 0, 239.5], [0, 500.0, 149.5], [0, 0, 1]])


def camera(place: float, **changed) -> Camera:
    """Return a camera at `place` on the x axis that looks along z, as the views of `collections_fakes` are seen."""
    R = changed.get("R", np.eye(3))
    return Camera(K=K, R=R, t=-R @ np.array([place, 0.0, 0.0]), width=480, height=300)


def chain(group: str, count: int, first: int = 0) -> list[Pair]:
    """Return pairs of neighbours in a row of photographs, scene `row`; no file is there."""
    files = [Path("data/real", group, "images", f"{k:02}.jpg") for k in range(first, first + count)]
    return [
        camera_pair(files[k], map(camera, (first + k, first + k + 1)), pair_id=f"{k}", scene="row", image2=files[k + 1])
        for k in range(count - 1)
    ]
