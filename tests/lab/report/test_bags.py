"""The report on bags: totals over the same bags for all methods, intervals over scenes, what is not present."""

from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest

from bags_fakes import PARAMS
from epiprior_lab.bags.choose import PLAIN, STRANGER, TWINS
from epiprior_lab.bags.measure import INTRINSICS, BagRecord
from epiprior_lab.report.bags import intruder_table, small_table, summary_table, write_bag_report

METHODS = ["colmap", "preprocess", "aliked"]


def record(method, kind, size, scene, intrinsics, **found):
    known = {"images": size, "registered": size, "wrong": 0, "others": 0, "strangers": 0, "accuracy": 0.5, "tracks": 10}
    about = {"group": "set", "scene": scene, "kind": kind, "size": size, "bag": f"{scene}-{kind}-{size}"}
    seconds = {"features_s": 3.0, "matching_s": 6.0, "mapping_s": 1.0, "track_length": 2.5}
    return asdict(BagRecord(**about, method=method, intrinsics=intrinsics, **{**known, **seconds, **found}))


@pytest.fixture
def records():
    """COLMAP registers 2 of 3, ours all, one of them wrong in one scene; ALIKED has bags of 5 only."""
    rows = []
    for intrinsics in INTRINSICS:
        for scene in ("a", "b"):
            for size in (3, 5):
                rows += [record("colmap", PLAIN, size, scene, intrinsics, registered=2, accuracy=0.2)]
                rows += [record("preprocess", PLAIN, size, scene, intrinsics, wrong=int(scene == "a"))]
            rows += [record("aliked", PLAIN, 5, scene, intrinsics)]
            for method in METHODS:
                taken = int(method == "aliked" and scene == "b")
                rows += [record(method, STRANGER, 5, scene, intrinsics, others=1, strangers=taken)]
            rows += [record(method, TWINS, 4, scene, intrinsics, others=4, strangers=2) for method in METHODS[:1]]
    frame = pd.DataFrame(rows)
    frame.insert(4, "difficulty", np.where(frame["scene"] == "a", "hard", "easy"))
    return frame


def test_a_method_is_shown_where_it_has_all_bags(records):
    table = summary_table(records, PARAMS.report)
    known = table[table["intrinsics"] == "known"].set_index(["selection", "method"])
    assert {name for name, method in known.index if method == "aliked"} == {"bags of 5"}
    assert {name for name, _ in known.index} == {"bags of 3", "bags of 5", "easy", "hard", "all", "set"}
    ours, colmap = known.loc[("all", "preprocess")], known.loc[("all", "colmap")]
    assert (ours["bags"], ours["scenes"], ours["images"], ours["registered"], ours["wrong"]) == (4, 2, 16, 16, 2)
    assert ours["right"] == pytest.approx(np.mean([2 / 3, 4 / 5, 1, 1]))
    assert colmap["right"] == pytest.approx(np.mean([2 / 3, 2 / 5]))
    assert ours["right_gain"] == pytest.approx(ours["right"] / colmap["right"] - 1)
    assert (colmap["right_gain"], ours["accuracy_gain"]) == (0.0, pytest.approx(1.5))
    # Whole scenes are drawn: the ends are the scenes themselves.
    assert ours["right_low"] == pytest.approx(np.mean([2 / 3, 4 / 5]))
    assert ours["right_high"] == pytest.approx(1.0)
    hard = known.loc[("hard", "preprocess")]
    assert hard["scenes"] == 1
    assert np.isnan([hard["right_low"], hard["accuracy_high"], hard["right_gain_low"]]).all()
    assert (ours["tracks"], ours["track_length"]) == (10.0, 2.5)


def test_the_small_table_and_what_should_not_be_registered(records):
    summary, intruders = summary_table(records, PARAMS.report), intruder_table(records)
    table = small_table(summary, intruders, [*METHODS, "disk"], PARAMS.report.sizes)
    head = [f"{part}: right of {n}" for part, n in (("bags of 3", 6), ("bags of 5", 10), ("hard", 8))]
    measures = [column for first in head for column in (first, "wrong", "accuracy")]
    assert table.head == ["matches", *measures, "strangers", "twins joined"]
    assert table.rows == [
        ["COLMAP", "4", "0", "0.20", "4", "0", "0.20", "4", "0", "0.20", "0 of 2", "2 of 2"],
        ["ALIKED + LightGlue", "", "", "", "**10**", "0", "**0.50**", "", "", "", "1 of 2", ""],
        ["DISK + LightGlue", "not present", *[""] * 10],
        ["ours", "**5**", "1", "**0.50**", "9", "1", "**0.50**", "**6**", "2", "**0.50**", "0 of 2", ""],
    ]
    table = intruders.set_index(["kind", "intrinsics", "method"])
    found = table.loc[(STRANGER, "known", "aliked")]
    assert (found["bags"], found["others"], found["strangers"], found["taken"]) == (2, 2, 1, 1)
    assert table.loc[(TWINS, "inferred", "colmap")][["strangers", "taken"]].tolist() == [4, 2]


def test_all_is_written_and_seconds_stand_apart(records, tmp_path):
    write_bag_report(records, METHODS, PARAMS.report, tmp_path)
    files = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*"))
    tables = [f"tables/{name}.csv" for name in ("bags", "intruders", "summary")]
    assert files == ["figures/bags.png", "performance.md", *tables, "timings/seconds.csv", "timings/times.md"]
    page = (tmp_path / "performance.md").read_text()
    assert "not present" not in page
    for text in (
        "| ALIKED + LightGlue |  |  |  | **10** |",
        "**bags of 3: 2 bags, 2 scenes**",
        "### Inferred intrinsics",
    ):
        assert text in page
    before = {name: (tmp_path / name).read_bytes() for name in files}
    write_bag_report(records.assign(mapping_s=9.0), METHODS, PARAMS.report, tmp_path)
    changed = [name for name in files if (tmp_path / name).read_bytes() != before[name]]
    assert changed == ["timings/seconds.csv", "timings/times.md"]
    assert "| COLMAP | 0.80 | 1.30 | 9.00 | 9.00 |" in (tmp_path / "timings/times.md").read_text()
