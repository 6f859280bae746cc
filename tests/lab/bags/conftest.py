"""A pair set of views from cameras side by side, whose truth is known."""

import pytest

from bags_fakes import camera
from collections_fakes import views
from epiprior_lab.pairsets.files import write_tables

COUNT = 4


@pytest.fixture(scope="session")
def side_by_side(tmp_path_factory):
    """The folder of the set `side`: a chain, so that only neighbours are paired."""
    root = tmp_path_factory.mktemp("bags") / "real" / "side"
    root.mkdir(parents=True)
    views(root / "images", COUNT)
    names = [f"images/{k}.png" for k in range(COUNT)]
    rows = [[f"p{k}", names[k], names[k + 1], "cameras", "wall", ""] for k in range(COUNT - 1)]
    write_tables(root, rows, {name: camera(k) for k, name in enumerate(names)})
    return root
