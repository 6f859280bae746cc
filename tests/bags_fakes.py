"""Made-up sets, parameters and records of the benchmark on bags of photographs."""

from pathlib import Path

import numpy as np

from epiprior_lab.bags.params import PATH, BagParams, SfmParams, load_sfm_params
from epiprior_lab.pairsets import Camera, Pair

COMMITTED = load_sfm_params(Path(__file__).parents[1] / PATH)
PARAMS = SfmParams(
    bags=BagParams(seed=1, groups=("long",), per_scene={3: 2, 5: 1}, stranger_size=5),
    twins=COMMITTED.twins,
    methods=COMMITTED.methods,
    mapper=COMMITTED.mapper,
    report=COMMITTED.report.__class__(
        seed=0, bootstrap_draws=200, against="colmap", sizes=(3, 5), easy_share=0.5, hard_share=0.2
    ),
)
K = np.array([[500.0, 0, 239.5], [0, 500.0, 149.5], [0, 0, 1]])


def camera(place: float, **changed) -> Camera:
    """Return a camera at `place` on the x axis that looks along z, as the views of `collections_fakes` are seen."""
    R = changed.get("R", np.eye(3))
    return Camera(K=K, R=R, t=-R @ np.array([place, 0.0, 0.0]), width=480, height=300)


def chain(group: str, count: int, first: int = 0) -> list[Pair]:
    """Return pairs of neighbours in a row of photographs, scene `row`; no file is there."""
    files = [Path("data/real", group, "images", f"{k:02}.jpg") for k in range(first, first + count)]
    return [
        Pair(
            pair_id=f"{k}",
            scene="row",
            image1=files[k],
            image2=files[k + 1],
            camera1=camera(first + k),
            camera2=camera(first + k + 1),
            difficulty="",
        )
        for k in range(count - 1)
    ]
