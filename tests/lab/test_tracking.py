"""Tracking of training runs by MLflow: runs, folds, models, promotion, and failures that stop nothing."""

import logging
import re
import warnings

import pytest
from matplotlib.figure import Figure

from epiprior_lab import tracking
from epiprior_lab.tracking import Run, TrackingError, promote, repository_root, track
from epiprior_lab.training.families import fit
from epiprior_lab.training.onnx_graphs import to_onnx
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows(900)


def run_of(target="two_keypoint", family="tree"):
    """An exported tree with a model, or another family without."""
    exported = family == "tree"
    tags = {"preset": "paper", "family": family, "exported": str(exported).lower()}
    metrics = {"log_loss": 0.25, "log_loss.deviation": float("nan")}
    folds = [{"log_loss": number / 10} for number in range(3)]
    values = {"parameters": {"folds": 3}, "folds": folds, "rows": ROWS.rows[:5]}
    onnx = to_onnx(fit("tree", ROWS.rows, ROWS.labels, seed=1)) if exported else None
    pictures = {"reliability.png": Figure()}
    return Run(
        experiment=target, name=f"paper-{family}", tags=tags, metrics=metrics, figures=pictures, onnx=onnx, **values
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Return the root of a database with a tree (exported) and an SVM for both targets."""
    root = tmp_path_factory.mktemp("tracking")
    runs = [run_of(target, family) for target in ("two_keypoint", "match") for family in ("tree", "svm")]
    assert track(runs, root=root)
    return root


def runs_of(root, target, filter_string=""):
    with tracking._mlflow(root) as client:
        experiment = client.get_experiment_by_name(f"epiprior/{target}")
        return client.search_runs([experiment.experiment_id], filter_string)


def test_everything_lies_at_the_root_and_the_state_of_mlflow_is_put_back(store):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlflow
    assert sorted(path.name for path in store.iterdir()) == ["mlartifacts", "mlflow.db"]
    before = mlflow.get_tracking_uri()
    with tracking._mlflow(store) as client:
        assert mlflow.get_tracking_uri() != before
        tags = client.get_experiment_by_name("epiprior/match").tags
    assert tags["mlflow.experimentKind"] == "custom_model_development"  # what the page opens on
    assert mlflow.get_tracking_uri() == before


@pytest.mark.parametrize("target", ["two_keypoint", "match"])
def test_a_run_with_a_nested_run_per_fold(store, target):
    runs = runs_of(store, target)
    parents = {run.info.run_id: run for run in runs if "preset" in run.data.tags}
    assert sorted(run.info.run_name for run in parents.values()) == ["paper-svm", "paper-tree"]
    for run in parents.values():
        assert run.data.metrics == {"log_loss": 0.25}  # what is not finite is left out
        assert (run.data.params["folds"], run.data.params["preset"]) == ("3", "paper")
        with tracking._mlflow(store) as client:
            assert [item.path for item in client.list_artifacts(run.info.run_id)] == ["reliability.png"]
        assert bool(run.outputs.model_outputs) == (run.data.tags["family"] == "tree")  # which is exported
    folds = [run for run in runs if "fold" in run.data.tags]
    assert len(folds) == 6
    for fold in folds:
        assert fold.data.tags["mlflow.parentRunId"] in parents
        assert fold.data.metrics == {"log_loss": int(fold.data.tags["fold"]) / 10}
    assert all(run.info.status == "FINISHED" for run in runs)


def test_promotion_is_explicit_takes_the_newest_and_names_what_is_not_there(store, tmp_path):
    with tracking._mlflow(store) as client:
        assert not client.search_registered_models()
    assert promote("paper", root=store) == {"epiprior-paper-two_keypoint": "1", "epiprior-paper-match": "1"}
    assert track([run_of("match")], root=store)
    assert promote("paper", root=store)["epiprior-paper-match"] == "2"
    with tracking._mlflow(store) as client:
        version = client.get_model_version_by_alias("epiprior-paper-match", "champion")
    newest = max(runs_of(store, "match", "tags.exported = 'true'"), key=lambda run: run.info.start_time)
    assert version.run_id == newest.info.run_id
    for preset, root, message in (
        ("default", store, "no finished run of an exported two_keypoint classifier"),
        ("paper", tmp_path, r"mlflow.db: no such file"),
    ):
        with pytest.raises(TrackingError, match=message):
            promote(preset, root=root)


def test_a_failure_warns_and_goes_on(tmp_path, caplog):
    (tmp_path / "mlflow.db").write_text("this is no database, " * 100)
    with caplog.at_level(logging.WARNING, logger="epiprior_lab.tracking"):
        assert track([run_of()], root=tmp_path) is False
    assert "not everything was tracked" in caplog.text


def test_the_root_is_dvcs_or_the_folder_of_the_pipeline(tmp_path, monkeypatch, caplog):
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    monkeypatch.delenv("DVC_ROOT", raising=False)
    with pytest.raises(TrackingError, match=re.escape("no dvc.yaml")):
        repository_root()
    with caplog.at_level(logging.WARNING, logger="epiprior_lab.tracking"):
        assert track([]) is False
    assert "DVC_ROOT is not set" in caplog.text
    (tmp_path / "dvc.yaml").write_text("stages: {}\n")
    assert repository_root() == tmp_path
    monkeypatch.setenv("DVC_ROOT", str(tmp_path / "elsewhere"))
    assert repository_root() == tmp_path / "elsewhere"
