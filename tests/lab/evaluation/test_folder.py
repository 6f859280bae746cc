from calls import refused
from epiprior.errors import SettingsError
from epiprior_lab.evaluation import folder as own
from epiprior_lab.evaluation.records import Tables
from epiprior_lab.evaluation.sets import link_sets


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
    where = {"out": tmp_path / "out", "store": tmp_path / "store"}
    tables = own.evaluate_folder(relief.parent, seeds=2, estimators=("usac",), **where)
    assert {path.stem for path in (tmp_path / "out").glob("*.csv")} == set(Tables.kinds)
    runs = Tables.read([tmp_path / "out"]).runs
    assert len(runs) == len(tables.runs) == 2 * 3 * 2
    own_runs = runs[runs["pair_id"] == "relief-0"]
    assert (own_runs["status"] == "ok").all()
    assert (own_runs["error_px"] < 3).all()
    for bad, message in (({"seeds": 0}, "seeds is 0"), ({"estimators": ("usak",)}, "'usak'")):
        refused(SettingsError, message, own.evaluate_folder, relief.parent, **bad)
