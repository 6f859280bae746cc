"""Tracking of training runs by MLflow: runs, folds, models, promotion, and failures that stop nothing."""

import logging
import warnings

import pytest

from epiprior_lab import tracking
from epiprior_lab.params import TrainParams
from epiprior_lab.tracking import TrackingError, promote, track
from epiprior_lab.training.comparison import compare
from epiprior_lab.training.cross_validation import METRICS
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
EXPORTED = {"paper": "tree", "default": "tree", "confidence": "tree"}
CAPS = {"max_rows_per_pair": 100, "max_rows": 400, "max_forest_rows": 400, "max_svm_rows": 400}
PARAMS = TrainParams(seed=3, folds=3, families=("tree", "svm"), exported=EXPORTED, **CAPS)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Comparisons of a tree (exported) and an SVM for both targets."""
    rows = [make_rows(900, target=target) for target in ("two_keypoint", "match")]
    return [compare("paper", own, PARAMS, tmp_path_factory.mktemp("tasks")) for own in rows]


@pytest.fixture(scope="module")
def store(compared, tmp_path_factory):
    """Return the root of a database of both comparisons."""
    root = tmp_path_factory.mktemp("tracking")
    track(compared, {"seed": 3}, root=root)
    return root


def runs_of(root, target, filter_string=""):
    with tracking._mlflow(root) as mlflow:
        experiment = mlflow.get_experiment_by_name(f"epiprior/{target}")
        return mlflow.MlflowClient().search_runs([experiment.experiment_id], filter_string)


def test_everything_lies_at_the_root_and_the_state_of_mlflow_is_put_back(store):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlflow
    assert sorted(path.name for path in store.iterdir()) == ["mlartifacts", "mlflow.db"]
    before = mlflow.get_tracking_uri()
    with tracking._mlflow(store):
        assert mlflow.get_tracking_uri() != before
        tags = mlflow.get_experiment_by_name("epiprior/match").tags
    assert tags["mlflow.experimentKind"] == "custom_model_development"  # what the page opens on
    assert mlflow.get_tracking_uri() == before


@pytest.mark.parametrize("target", ["two_keypoint", "match"])
def test_a_run_with_a_nested_run_per_fold(compared, store, target):
    runs = runs_of(store, target)
    parents = {run.info.run_id: run for run in runs if "preset" in run.data.tags}
    assert sorted(run.info.run_name for run in parents.values()) == ["paper-svm", "paper-tree"]
    for run in parents.values():
        metrics, family, exported = run.data.metrics, run.data.tags["family"], run.data.tags["exported"] == "true"
        assert exported == (family == "tree") == bool(run.outputs.model_outputs)
        for name in METRICS:
            assert {name, f"{name}.deviation", f"calibrated.{name}"} <= metrics.keys()
            assert metrics[name] == compared[target == "match"].grouped[family].metrics[name]
            assert (f"ungrouped.{name}" in metrics) == exported
        assert (run.data.params["seed"], run.data.params["rows"], run.data.params["preset"]) == ("3", "900", "paper")
        with tracking._mlflow(store) as mlflow:
            figures = [item.path for item in mlflow.MlflowClient().list_artifacts(run.info.run_id)]
        assert figures == ["importances.png"] * exported + ["precision_recall.png", "reliability.png"]
    folds = [run for run in runs if "fold" in run.data.tags]
    assert len(folds) == 6
    for fold in folds:
        found = compared[target == "match"].grouped[parents[fold.data.tags["mlflow.parentRunId"]].data.tags["family"]]
        assert fold.data.metrics["log_loss"] == found.fold_metrics[int(fold.data.tags["fold"])]["log_loss"]
    assert all(run.info.status == "FINISHED" for run in runs)


def test_promotion_is_explicit_takes_the_newest_and_names_what_is_not_there(compared, store, tmp_path):
    with tracking._mlflow(store) as mlflow:
        assert not mlflow.search_registered_models()
    assert promote("paper", root=store) == {"epiprior-paper-two_keypoint": "1", "epiprior-paper-match": "1"}
    track(compared[1:], {}, root=store)
    assert promote("paper", root=store)["epiprior-paper-match"] == "2"
    with tracking._mlflow(store) as mlflow:
        version = mlflow.MlflowClient().get_model_version_by_alias("epiprior-paper-match", "champion")
    newest = max(runs_of(store, "match", "tags.exported = 'true'"), key=lambda run: run.info.start_time)
    assert version.run_id == newest.info.run_id
    for preset, root, message in (
        ("default", store, "no finished run of an exported two_keypoint classifier"),
        ("paper", tmp_path, r"mlflow.db: no such file"),
    ):
        with pytest.raises(TrackingError, match=message):
            promote(preset, root=root)


def test_a_failure_warns_and_goes_on_and_the_root_is_dvcs(compared, tmp_path, caplog, monkeypatch):
    monkeypatch.setenv("DVC_ROOT", str(tmp_path))
    (tmp_path / "mlflow.db").write_text("this is no database, " * 100)
    with caplog.at_level(logging.WARNING, logger="epiprior_lab.tracking"):
        track(compared, {})
    assert "not everything was tracked" in caplog.text
