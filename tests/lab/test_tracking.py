import logging
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from epiprior_lab import tracking
from epiprior_lab.export.onnx_files import to_onnx
from epiprior_lab.tracking import TrackedFamily, TrackingError, promote, repository_root, track
from epiprior_lab.training.cross_validation import cross_validate, fit_final
from epiprior_lab.training.metrics import METRICS
from grouped_rows import COLUMNS, make_rows

ROWS = make_rows(900)


def tracked(target="two_keypoint", family="tree", preset="paper", exported=True):
    grouped, ungrouped = (
        cross_validate(family, ROWS.X, ROWS.y, ROWS.scene, ROWS.pair, columns=COLUMNS, folds=3, seed=1, grouped=grouped)
        for grouped in (True, False)
    )
    final = fit_final(family, ROWS.X, ROWS.y, seed=1)
    return TrackedFamily(
        target=target,
        preset=preset,
        exported=exported,
        grouped=grouped,
        ungrouped=ungrouped if exported else None,
        labels=ROWS.y,
        importances=final.importances(),
        onnx=to_onnx(final),
        example=ROWS.X,
        parameters={"seed": 1, "folds": 3},
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Return the root of a database with a tree (exported) and an SVM for both targets."""
    root = tmp_path_factory.mktemp("tracking")
    families = [
        tracked(target, family, exported=family == "tree")
        for target in ("two_keypoint", "match")
        for family in ("tree", "svm")
    ]
    assert track(families, root=root)
    return root


def runs_of(root, target, filter_string=""):
    with tracking._mlflow(root) as client:
        experiment = client.get_experiment_by_name(f"epiprior/{target}")
        return client.search_runs([experiment.experiment_id], filter_string)


def test_everything_lies_at_the_root(store):
    assert sorted(path.name for path in store.iterdir()) == ["mlartifacts", "mlflow.db"]


def test_the_page_opens_on_training_runs(store):
    with tracking._mlflow(store) as client:
        tags = client.get_experiment_by_name("epiprior/match").tags
    assert tags["mlflow.experimentKind"] == "custom_model_development"


@pytest.mark.parametrize("target", ["two_keypoint", "match"])
def test_a_run_per_family_with_a_nested_run_per_fold(store, target):
    parents = {run.info.run_id: run for run in runs_of(store, target) if "preset" in run.data.tags}
    assert sorted(run.info.run_name for run in parents.values()) == ["paper-svm", "paper-tree"]
    folds = [run for run in runs_of(store, target) if "fold" in run.data.tags]
    assert len(folds) == 6
    for fold in folds:
        assert fold.data.tags["mlflow.parentRunId"] in parents
        assert set(METRICS) - {"precision"} <= set(fold.data.metrics)
    assert all(run.info.status == "FINISHED" for run in runs_of(store, target))


def test_metrics_of_the_parent(store):
    (run,) = runs_of(store, "match", "tags.family = 'tree'")
    for name in METRICS:
        assert name in run.data.metrics
        assert f"{name}.deviation" in run.data.metrics
        assert f"ungrouped.{name}" in run.data.metrics
        assert f"calibrated.{name}" in run.data.metrics
    assert run.data.metrics["seconds_per_10000_rows"] > 0
    assert all(re.fullmatch(r"[\w./-]+", name) for name in run.data.metrics)
    assert run.data.params["columns"] == "count, ratio, angle, level, noise"
    assert run.data.params["folds"] == "3"
    assert run.data.tags["exported"] == "true"
    (other,) = runs_of(store, "match", "tags.family = 'svm'")
    assert run.data.metrics.keys() - other.data.metrics.keys() >= {f"ungrouped.{name}" for name in METRICS}


@pytest.mark.parametrize(
    ("family", "figures"),
    [
        ("tree", ["importances.png", "precision_recall.png", "reliability.png"]),
        ("svm", ["precision_recall.png", "reliability.png"]),
    ],
)
def test_figures(store, family, figures):
    (run,) = runs_of(store, "match", f"tags.family = '{family}'")
    with tracking._mlflow(store) as client:
        assert sorted(item.path for item in client.list_artifacts(run.info.run_id)) == figures


def test_a_model_can_be_loaded_from_its_run(store):
    (run,) = runs_of(store, "match", "tags.family = 'svm'")
    with tracking._mlflow(store):
        import mlflow

        model = mlflow.pyfunc.load_model(f"runs:/{run.info.run_id}/model")
        said = model.predict({"rows": ROWS.X[:20]})["probability"]
        assert model.metadata.signature.inputs.input_names() == ["rows"]
        assert model.input_example["rows"].shape == (5, 5)
    expected = fit_final("svm", ROWS.X, ROWS.y, seed=1).probability(ROWS.X[:20])
    np.testing.assert_allclose(said, expected, atol=1e-6)


def test_promotion_is_explicit_and_takes_the_newest(store):
    with tracking._mlflow(store) as client:
        assert not client.search_registered_models()
    assert promote("paper", root=store) == {"epiprior-paper-two_keypoint": "1", "epiprior-paper-match": "1"}
    assert track([tracked("match")], root=store)
    assert promote("paper", root=store)["epiprior-paper-match"] == "2"
    with tracking._mlflow(store) as client:
        version = client.get_model_version_by_alias("epiprior-paper-match", "champion")
        assert version.version in (2, "2")
        newest = max(
            (run for run in runs_of(store, "match", "tags.exported = 'true'")),
            key=lambda run: run.info.start_time,
        )
        assert version.run_id == newest.info.run_id


def test_promotion_of_what_is_not_there(store, tmp_path):
    with pytest.raises(TrackingError, match="no finished run of an exported two_keypoint classifier"):
        promote("default", root=store)
    with pytest.raises(TrackingError, match=r"mlflow.db: no such file"):
        promote("paper", root=tmp_path)


def test_a_failure_warns_and_goes_on(tmp_path, caplog):
    (tmp_path / "mlflow.db").write_text("this is no database, " * 100)
    with caplog.at_level(logging.WARNING, logger="epiprior_lab.tracking"):
        assert track([tracked()], root=tmp_path) is False
    assert "not everything was tracked" in caplog.text


def test_without_a_root_it_warns_and_goes_on(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DVC_ROOT", raising=False)
    with caplog.at_level(logging.WARNING, logger="epiprior_lab.tracking"):
        assert track([]) is False
    assert "DVC_ROOT is not set" in caplog.text


def test_the_root_is_dvcs_or_the_folder_of_the_pipeline(tmp_path, monkeypatch):
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    monkeypatch.delenv("DVC_ROOT", raising=False)
    with pytest.raises(TrackingError, match=re.escape("no dvc.yaml")):
        repository_root()
    (tmp_path / "dvc.yaml").write_text("stages: {}\n")
    assert repository_root() == tmp_path
    monkeypatch.setenv("DVC_ROOT", str(tmp_path / "elsewhere"))
    assert repository_root() == tmp_path / "elsewhere"


def test_the_state_of_mlflow_is_put_back(store):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlflow
    before = mlflow.get_tracking_uri()
    with tracking._mlflow(store):
        assert mlflow.get_tracking_uri() != before
    assert mlflow.get_tracking_uri() == before


def test_nothing_but_tracking_imports_mlflow():
    source = Path(tracking.__file__).parents[1]
    for path in source.rglob("*.py"):
        if path.name != "tracking.py":
            assert not re.search(r"^\s*(import|from) mlflow", path.read_text(), re.MULTILINE), path
