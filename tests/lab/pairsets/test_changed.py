"""Pair sets whose second photographs are turned or shrunk: pixels and truth change alike."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from epiprior.geometry import sampson_distance
from epiprior_lab.evaluation.sets import make_changed_sets
from epiprior_lab.pairsets import DatasetError, read_pair_set, transfer_distance, write_pair_set
from epiprior_lab.pairsets.changed import CHANGES, EVERY, chosen_pairs, write_changed_set
from epiprior_lab.pairsets.files import write_control_points, write_matrix
from lab.pairsets.test_datasets import files

POINTS = np.array([[30.0, 40.0], [200.0, 77.0], [111.0, 150.0], [60.0, 20.0], [90.0, 99.0]])


def dots(points):
    """Return a dark image with a bright spot, wide enough to be shrunk, at each of the points."""
    y, x = np.mgrid[:240, :320]
    spots = [np.exp(-((x - u) ** 2 + (y - v) ** 2) / 60) for u, v in points]
    return cv2.cvtColor(np.rint(250 * np.max(spots, axis=0)).astype(np.uint8), cv2.COLOR_GRAY2BGR)


@pytest.fixture
def root(tmp_path):
    """A set of one pair of each kind of truth: all second images show the first ones shifted, but for the cameras."""
    write_pair_set(tmp_path / "given", [files("cameras")])
    root = tmp_path / "given"
    for path in (root / "depth").iterdir():
        path.unlink()
    shifted = POINTS + [12.0, 5.0]
    H, F = np.array([[1.0, 0, 12], [0, 1, 5], [0, 0, 1]]), np.array([[0.0, 0, 5], [0, 0, -12], [-5, 12, 0]])
    rows = ""
    for kind in ("control_points", "homography", "fundamental"):
        for side, points in enumerate((POINTS, shifted), 1):
            cv2.imwrite(str(root / "images" / f"{kind}-{side}.png"), dots(points))
        write_control_points(root / "control_points" / f"{kind}.csv", POINTS, shifted)
        rows += f"{kind},images/{kind}-1.png,images/{kind}-2.png,{kind},a scene,\n"
    write_matrix(root / "homography" / "homography.txt", H)
    write_matrix(root / "fundamental" / "fundamental.txt", F)
    with (root / "pairs.csv").open("a") as table:
        table.write(rows)
    return root


@pytest.mark.parametrize("change", CHANGES)
def test_pixels_and_truth_change_alike(root, tmp_path, change):
    given = {f"given-{pair.pair_id}": pair for pair in read_pair_set(root).pairs}
    write_changed_set(tmp_path / change, given, change)
    pairs = {pair.pair_id: pair for pair in read_pair_set(tmp_path / change).pairs}
    assert list(pairs) == list(given)
    assert pairs["given-homography"].scene == "given-a scene"
    for name, pair in pairs.items():
        before = given[name]
        size1, (width, height) = before.sizes()
        size2 = {"turned90": (height, width), "shrunk4": (width // 4, height // 4)}.get(change, (width, height))
        assert pair.sizes() == (size1, size2)
        if name == "given-cameras":
            points = np.array([[0.5, 0.2, 9.0], [-1.0, 0.4, 12.0], [1.0, -0.7, 20.0]])
            x2, _ = before.camera2.project(points)
            found, _ = pair.camera2.project(points)
            at = {"turned90": np.column_stack([height - 1 - x2[:, 1], x2[:, 0]]), "shrunk4": (x2 + 0.5) / 4 - 0.5}
            np.testing.assert_allclose(found, at.get(change, [width - 1, height - 1] - x2), atol=1e-9)
            assert (sampson_distance(pair.fundamental(), before.camera1.project(points)[0], found) < 1e-6).all()
            continue
        x1, x2 = pair.control_points()
        image = cv2.imread(str(pair.image2), cv2.IMREAD_GRAYSCALE)
        values = cv2.remap(image, *x2.astype(np.float32).T, cv2.INTER_CUBIC).ravel()
        assert values.min() > (180 if change == "shrunk4" else 245)  # on the spots
        if pair.homography() is not None:
            assert transfer_distance(pair.homography(), x1, x2).max() < 1e-5
        if pair.fundamental() is not None:
            assert sampson_distance(pair.fundamental(), x1, x2).max() < 1e-5


def test_pairs_are_chosen_by_rule_sets_made_anew_and_depth_maps_refused(root, tmp_path):
    assert make_changed_sets(("fox", "given"), ("given",), folder=tmp_path) == []
    (made,) = make_changed_sets(("fox", "turned90"), ("given",), without=("cameras",), folder=tmp_path)
    assert [pair.pair_id for pair in read_pair_set(made).pairs] == ["given-control_points"]
    (made / "images" / "left.png").touch()
    make_changed_sets(("turned90",), ("given",), folder=tmp_path)
    assert not (made / "images" / "left.png").exists()
    assert [pair.pair_id for pair in read_pair_set(made).pairs] == ["given-cameras"]
    write_pair_set(tmp_path / "given", [files("p")])
    with pytest.raises(DatasetError, match="depth maps"):
        write_changed_set(tmp_path / "out", {"given-p": read_pair_set(tmp_path / "given").pairs[0]}, "turned90")
    pairs = [SimpleNamespace(pair_id=f"{k}") for k in range(EVERY + 2)]
    sets = {"a": pairs, "b": pairs[:EVERY]}
    assert list(chosen_pairs(sets)) == ["a-0", f"a-{EVERY}", f"b-{EVERY - 2}"]
    assert list(chosen_pairs(sets, without=["0"])) == ["a-1", f"a-{EVERY + 1}"]
