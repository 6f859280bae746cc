"""A pair set of a relief whose true epipolar lines are the rows, and of a pair without texture."""

import numpy as np
import pytest

from epiprior_lab.pairsets import read_pair_set, write_control_points
from pictures import relief_pair, save


@pytest.fixture(scope="session")
def relief(tmp_path_factory):
    """The folder of the set, and beside it the matches of a peer, `twin`, which are right."""
    root = tmp_path_factory.mktemp("sets") / "relief"
    peer = root.parent / "peers" / "relief" / "twin"
    for folder in (root / "images", root / "control_points", peer):
        folder.mkdir(parents=True)
    y, x = np.mgrid[10:350:9j, 10:400:9j]
    disparity = 25 + 12 * np.sin(x / 45) * np.cos(y / 40) + 8 * np.sin(y / 23)
    points = np.column_stack([(x + disparity).ravel(), y.ravel(), x.ravel(), y.ravel()])
    ones = dict.fromkeys(("scale1", "scale2", "orientation1_deg", "orientation2_deg"), np.ones(len(points)))
    indices = dict.fromkeys(("feature1", "feature2"), np.arange(len(points)))
    lines = ["pair_id,image1,image2,gt,scene,difficulty"]
    for name, images in (("relief-0", relief_pair()), ("blank-0", 2 * (np.full((360, 480), 128, np.uint8),))):
        for side, image in enumerate(images, start=1):
            save(root / "images" / f"{name}-{side}.png", image)
        lines.append(f"{name},images/{name}-1.png,images/{name}-2.png,control_points,{name[:-2]},")
        write_control_points(root / "control_points" / f"{name}.csv", points[:, :2], points[:, 2:])
        np.savez(peer / f"{name}.npz", x1=points[:, :2], x2=points[:, 2:], **ones, **indices)
    (root / "pairs.csv").write_text("\n".join(lines) + "\n")
    return root


@pytest.fixture(scope="session")
def pairs(relief):
    return read_pair_set(relief).pairs
