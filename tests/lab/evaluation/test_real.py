"""Evaluation on photographs: points without control points, sets, the table."""

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import epiprior.rank
from epiprior.errors import SettingsError
from epiprior.geometry import sampson_distance
from epiprior.ranking.models import load_model
from epiprior_lab.evaluation import folders as real
from epiprior_lab.evaluation.photographs.sets import link_sets
from epiprior_lab.pairsets import Camera, DatasetError, Pair
from pictures import relief_pair, save
from synthetic import HEIGHT, WIDTH, K, rotation
from tiny_model import make_model


@pytest.fixture
def datasets(tmp_path):
    root = tmp_path / "datasets" / "relief"
    (root / "images").mkdir(parents=True)
    (root / "control_points").mkdir()
    for name, image in zip("ab", relief_pair(), strict=True):
        save(root / "images" / f"{name}.png", image)
    (root / "pairs.csv").write_text(
        "pair_id,image1,image2,gt,scene,difficulty\np,images/a.png,images/b.png,control_points,s,\n"
    )
    rng = np.random.default_rng(0)
    points = rng.uniform(20, 300, (30, 4))
    points[:, 3] = points[:, 1]  # rows correspond
    np.savetxt(root / "control_points" / "p.csv", points, delimiter=",", header="x1,y1,x2,y2", comments="")
    return tmp_path / "datasets"


def camera_pair(tmp_path, t):
    first = Camera(K=K, R=np.eye(3), t=np.zeros(3), width=WIDTH, height=HEIGHT)
    second = Camera(K=K, R=rotation((0.1, 1, 0.2), 15), t=np.asarray(t), width=WIDTH, height=HEIGHT)
    return Pair(pair_id="p", scene="s", image1=tmp_path, image2=tmp_path, camera1=first, camera2=second, difficulty="")


def test_points_of_a_pair_with_cameras_only(tmp_path):
    pair = camera_pair(tmp_path, (-2.0, 0.3, 0.4))
    x1, x2 = real.evaluation_points(pair)
    assert len(x1) == len(x2) > 80
    assert sampson_distance(pair.fundamental(), x1, x2).max() < 1e-9
    for x in (x1, x2):
        assert (x >= 0).all()
        assert (x <= [WIDTH - 1, HEIGHT - 1]).all()
    assert np.ptp(x2, axis=0).min() > 300  # not all on one side
    wrong = camera_pair(tmp_path, (-2.0, 1.3, 0.4)).fundamental()
    assert sampson_distance(wrong, x1, x2).mean() > 10


def test_a_pair_without_any_truth_is_refused(tmp_path):
    pair = Pair(pair_id="p", scene="s", image1=tmp_path, image2=tmp_path, camera1=None, camera2=None, difficulty="")
    with pytest.raises(DatasetError, match="'p'"):
        real.evaluation_points(pair)


def test_find_sets_names_what_is_missing(datasets, tmp_path):
    assert [path.name for path in real.find_sets(datasets)] == ["relief"]
    with pytest.raises(SettingsError, match="'strecha'"):
        real.find_sets(datasets, ["relief", "strecha"])
    with pytest.raises(SettingsError, match=r"pairs\.csv"):
        real.find_sets(tmp_path / "nowhere")


def test_run_real(datasets, tmp_path, monkeypatch):
    folder = make_model(tmp_path / "default")
    model = load_model(folder)
    monkeypatch.setattr(epiprior.rank, "load_model", lambda name: model)
    monkeypatch.setattr(real, "find_model", lambda name: folder)
    console = Console(record=True, width=100, file=open("/dev/null", "w"))  # noqa: SIM115, PTH123
    out = tmp_path / "real.csv"
    real.run_real(datasets, seeds=2, out=out, workers=1, store=tmp_path / "store", console=console)
    console.file.close()
    text = console.export_text()
    assert "relief, 1 pairs" in text
    assert "all sets" not in text
    table = pd.read_csv(out)
    assert len(table) == 3 * 2
    assert set(table["input"]) == set(real.INPUTS)
    assert (table["status"] == "ok").all()
    assert (table["error_px"] < 3).all()
    assert table["precision_100"].between(0.5, 1).all()


def test_summary_counts_failures():
    rows = pd.DataFrame(
        {
            "set": "a",
            "scene": ["s", "s", "t", "t"] * 3,
            "pair_id": ["p", "p", "q", "q"] * 3,
            "input": np.repeat(real.INPUTS, 4),
            "seed": [0, 1, 0, 1] * 3,
            "status": ["ok", "ok", "no_model", "ok"] * 2 + ["ok", "ok", "degenerate", "ok"],
            "error_px": [1.0, 5.0, np.nan, 11.0] * 2 + [2.0, 2.0, 1.0, 9.0],
            "precision_100": [0.2, 0.2, 0.4, 0.4] * 3,
        }
    )
    got = real.summarise(rows).set_index("input")
    assert got.loc["snn", "pairs"] == 2
    assert got.loc["snn", "precision_100"] == pytest.approx(0.3)
    assert got.loc["snn", "successes_10"] == 1.0
    assert got.loc["snn", "successes_3"] == 0.5
    assert got.loc["default", "successes_10"] == 2.0  # a right F is right, whatever the verdict says
    assert got.loc["snn", "scene_share"] == 0.5
    assert got.loc["default", "scene_share"] == 1.0
    uneven = pd.concat([rows, rows[rows["pair_id"] == "p"].assign(pair_id="r")])
    assert real.summarise(uneven).set_index("input").loc["snn", "scene_share"] == 0.5
    assert real.summarise(uneven).set_index("input").loc["snn", "pairs"] == 3


def test_links_name_a_folder_that_is_not_there(datasets, tmp_path):
    folder = tmp_path / "real"
    link_sets(("relief",), datasets, folder)  # a second run must not take these links in silence
    with pytest.raises(SettingsError, match=r"datasetz: no such folder"):
        link_sets(("relief",), tmp_path / "datasetz", folder)
    with pytest.raises(SettingsError, match="holds no pair set of relief"):
        link_sets(("relief",), tmp_path, folder)
    assert link_sets(("relief",), folder, folder) == [folder / "relief"]  # no link to itself
    assert (folder / "relief").resolve() == (datasets / "relief").resolve()
