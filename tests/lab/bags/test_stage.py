"""The stage `sfm` from a pair set to a page; a second run takes everything from the store."""

import shutil
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from epiprior_lab.bags.params import PATH
from epiprior_lab.stages import sfm

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[3]
SHARES = "group,pair_id,right_share\nside,p0,0.1\nside,p1,0.1\nside,p2,0.1\nother,p0,0.9\n"


def test_from_a_pair_set_to_a_page(tmp_path, side_by_side, monkeypatch):
    pytest.importorskip("pycolmap")
    document = yaml.safe_load((ROOT / PATH).read_text(encoding="utf-8"))
    document["bags"] |= {"groups": ["side"], "per_scene": {3: 1}, "stranger_size": 3}
    document["twins"] |= {"styles": 1, "pairs": 1}
    document["methods"] |= {"names": ["colmap"], "learned_sizes": [3]}
    document["report"] |= {"sizes": [3], "bootstrap_draws": 100}
    for file, text in {PATH: yaml.safe_dump(document), sfm.SHARES: SHARES}.items():
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text(text)
    shutil.copytree(side_by_side, tmp_path / "data" / "real" / "side")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EPIPRIOR_WORKERS", "1")
    monkeypatch.setattr(sys, "argv", ["sfm"])
    sfm.main()
    bags = pd.read_csv("reports/sfm/tables/bags.csv")
    assert bags[["kind", "size", "method"]].value_counts().to_dict() == {
        ("plain", 3, "colmap"): 2,
        ("twins", 4, "colmap"): 2,
    }
    plain = bags[bags["kind"] == "plain"]
    assert (plain["registered"].tolist(), plain["difficulty"].tolist()) == ([3, 3], ["hard", "hard"])
    twins = bags[bags["kind"] == "twins"]
    assert (twins["images"].tolist(), twins["others"].tolist()) == ([2, 2], [2, 2])
    assert len(list(Path("data/sfm-twins").glob("*.jpg"))) == 4
    page = Path("reports/sfm/performance.md").read_text()
    assert "| ALIKED + LightGlue | not present |" in page
    assert "| COLMAP | **3** | 0 | **1.00** | **3** | 0 | **1.00** |" in page

    monkeypatch.setattr("epiprior_lab.bags.measure.map_database", None)
    monkeypatch.setattr("epiprior_lab.bags.twins.draw_street", None)
    shutil.rmtree("reports/sfm")
    sfm.main()
    assert Path("reports/sfm/performance.md").read_text() == page
