"""Small collections for tests, and a stand-in for the estimation of a pair."""

import sqlite3
from concurrent.futures import Future
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from epiprior import Status
from epiprior.collection.workers import Pool
from pictures import save, texture
from synthetic import make_estimate, make_pair

PAIR = make_pair(seed=1)
MATCHES = 60


def small_images(folder: Path, names=("a.png", "b.png", "c.png")) -> list[Path]:
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save(folder / name, texture(200, 150, number))
    return [folder / name for name in names]


def views(folder, count=5):
    """Views of pictures that hang at different depths, from cameras side by side: the nearer, the further it moves."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    hung = [
        (shift, rng.integers(0, 560), rng.integers(0, 220), texture(140, 110, k))
        for k, shift in enumerate(range(24, 64, 2))
    ]
    for k in range(count):
        view = texture(700, 300, 99)[:, 15 * k : 15 * k + 480].copy()
        for shift, x, y, picture in hung:  # the nearest last
            left, right = max(0, x - k * shift), min(480, x - k * shift + 140)
            if left < right:
                view[y : y + 110, left:right] = picture[: 300 - y, left - x + k * shift : right - x + k * shift]
        save(folder / f"{k}.png", view)
    return folder


def rows_of(path, *tables):
    """Return the sorted rows of tables of a database by their names; of all tables where none is named."""
    with closing(sqlite3.connect(path)) as opened:
        every = opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        return {name: sorted(opened.execute(f"SELECT * FROM {name}")) for name in tables or [row[0] for row in every]}


class FakeEstimation:
    """Matches the k-th place of image 1 with the k-th of image 2; notes the calls; `status` is that of all answers."""

    def __init__(self, status=Status.OK):
        self.calls, self.status = [], status

    def __call__(self, view1, view2, *, features1, features2, **options):
        self.calls.append(options | {"views": (view1, view2), "features": (features1, features2)})
        # Twins come along: a keypoint is a place.
        x1, x2 = (np.unique(f.xy, axis=0)[:MATCHES] for f in (features1, features2))
        count = min(len(x1), len(x2))
        x1, x2 = np.vstack([x1[:count], x1[:1]]), np.vstack([x2[:count], x2[1:2]])
        inliers = np.full(count + 1, self.status is Status.OK)
        about = {"x1": x1, "x2": x2, "inliers": inliers, "confidence": 1.0, "message": "as the test wants"}
        return replace(make_estimate(PAIR, self.status, **about), input="default")


def in_this_process(monkeypatch, estimation=None):
    """Run the tasks of collections here and now, with `estimation` for every pair; return it."""

    @contextmanager
    def here(workers=None, scheduler=None):
        def submit(function, *args):
            future = Future()
            try:
                future.set_result(function(*args))
            except Exception as error:  # noqa: BLE001 - whoever asks gets it
                future.set_exception(error)
            return future

        yield Pool(submit=submit, capacity=lambda: 1)

    monkeypatch.setattr("epiprior.collection.run.open_pool", here)
    estimation = estimation or FakeEstimation()
    monkeypatch.setattr("epiprior.collection.match.estimate_fundamental", estimation)
    return estimation
