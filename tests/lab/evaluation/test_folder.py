import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from calls import refused
from epiprior.errors import SettingsError
from epiprior_lab.evaluation import folder as own
from epiprior_lab.evaluation.records import RECORDS, Tables
from epiprior_lab.evaluation.sets import link_sets
from synthetic_tables import study_tables


def test_sets_are_found_and_linked(relief, tmp_path):
    datasets = relief.parent
    assert own.find_sets(datasets) == own.find_sets(datasets / "relief") == [datasets / "relief"]
    refused(SettingsError, "'strecha'", own.find_sets, datasets, ["relief", "strecha"])
    refused(SettingsError, r"pairs\.csv", own.find_sets, tmp_path / "nowhere")
    folder = tmp_path / "data" / "real"
    refused(SettingsError, "make real DATA=FOLDER", link_sets, ("relief",), None, folder)
    assert link_sets(("relief",), datasets, folder) == [folder / "relief"]
    assert (folder / "relief").is_symlink()
    assert not (folder / "relief").readlink().is_absolute()
    assert link_sets(("relief",), datasets, folder) == link_sets(("relief",), None, folder)
    own_set = folder / "mine"
    own_set.mkdir()
    (own_set / "pairs.csv").touch()
    assert link_sets(("mine", "relief"), datasets, folder)[0] == own_set  # a set that lies there stays
    # Links that are there are not taken in silence.
    refused(SettingsError, "no pair set absent in", link_sets, ("relief", "absent"), datasets, folder)
    refused(SettingsError, r"datasetz: no such folder", link_sets, ("relief",), tmp_path / "datasetz", folder)
    refused(SettingsError, "holds no pair set of relief", link_sets, ("relief",), tmp_path, folder)
    assert link_sets(("relief",), folder, folder) == [folder / "relief"]  # no link to itself
    assert (folder / "relief").resolve() == (datasets / "relief").resolve()


def test_a_folder_is_evaluated(relief, model_folder, tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(own, "find_model", lambda name: model_folder)
    monkeypatch.setenv("EPIPRIOR_WORKERS", "1")
    console = Console(record=True, width=100, file=io.StringIO())
    where = {"out": tmp_path / "out", "store": tmp_path / "store", "console": console}
    tables = own.evaluate_folder(relief.parent, seeds=2, estimators=("usac",), **where)
    text = console.export_text()
    assert "relief, 2 pairs" in text
    assert "all sets" not in text
    assert {path.stem for path in (tmp_path / "out").glob("*.csv")} == set(RECORDS)
    runs = Tables.read([tmp_path / "out"]).runs
    assert len(runs) == len(tables.runs) == 2 * 3 * 2
    own_runs = runs[runs["pair_id"] == "relief-0"]
    assert (own_runs["status"] == "ok").all()
    assert (own_runs["error_px"] < 3).all()
    for bad, message in (({"seeds": 0}, "seeds is 0"), ({"estimators": ("usak",)}, "'usak'")):
        refused(SettingsError, message, own.evaluate_folder, relief.parent, **bad)


def test_the_summary_counts_failures():
    tables = study_tables(pairs=4)
    found = own.summarise(tables).set_index(["estimator", "input"]).loc[("usac", "default")]
    runs = tables.runs.query("estimator == 'usac' and input == 'default'")
    right = runs["error_px"] < 10
    by_scene = right.groupby([runs["group"], runs["scene"]]).mean()
    final = tables.rankings.query("input == 'default' and ranking == 'final'")
    columns = ["pairs", "successes_10", "successes_3", "scene_share", "precision_100"]
    counts = [8, right.sum() / 3, (runs["error_px"] < 3).sum() / 3]
    assert found[columns].tolist() == pytest.approx([*counts, by_scene.mean(), final["right_100"].mean() / 100])
    assert np.isnan(own.summarise(replace(tables, rankings=tables.rankings[:0]))["precision_100"]).all()
