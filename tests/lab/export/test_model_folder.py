import json

import lightgbm
import numpy as np
import onnx
import pytest

from epiprior.presets import PAPER
from epiprior.ranking.models import load_model
from epiprior_lab.export.model_folder import ExportError, export_model, write_model
from epiprior_lab.training.families import FAMILIES, Boosted, fit
from epiprior_lab.training.onnx_graphs import to_onnx
from grouped_rows import COLUMNS, make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows()
TRAINING_DATA = {
    "sha256": "ab" * 32,
    "scenes": 12,
    "rankings": 24,
    "two_keypoint_rows": 2400,
    "two_keypoint_right": 700,
    "match_rows": 2000,
    "match_right": 300,
}
METRICS = {
    "precision_top_100": {"mean": 0.75, "deviation": 0.125, "calibrated": 0.75, "ungrouped": 0.875},
    "precision": {"mean": 0.5},
}


def write(folder, fitted, a=1.0, b=0.0):
    item = {"family": "tree", "columns": COLUMNS, "a": a, "b": b, "metrics": METRICS}
    write_model(
        folder,
        preset="default",
        summary={"training_data": TRAINING_DATA, "two_keypoint": item, "match": item},
        graphs=dict.fromkeys(("two_keypoint", "match"), to_onnx(fitted)),
        parameters={"max_keypoints": 4000},
    )


def thresholds_by_column(fitted):
    """Return (column, threshold) of every split of an exported ensemble of trees."""
    model = onnx.load_from_string(to_onnx(fitted))
    attributes = {item.name: onnx.helper.get_attribute_value(item) for item in model.graph.node[0].attribute}
    modes = attributes["nodes_modes"]
    return [
        (column, value)
        for column, value, mode in zip(attributes["nodes_featureids"], attributes["nodes_values"], modes, strict=True)
        if mode == b"BRANCH_LEQ"
    ]


def rows_on_thresholds(fitted):
    """Return rows, each with one value exactly on a threshold, or one float32 above or below it."""
    splits = thresholds_by_column(fitted)
    picked = np.random.default_rng(0).integers(0, len(splits), 4000)
    rows = ROWS.rows[np.random.default_rng(1).integers(0, len(ROWS.rows), 4000)].copy()
    for i, split in enumerate(picked):
        column, value = splits[split]
        value = np.float32(value)
        rows[i, column] = (value, np.nextafter(value, np.float32(9)), np.nextafter(value, np.float32(-9)))[i % 3]
    return rows


@pytest.mark.parametrize("family", FAMILIES)
def test_the_library_predicts_what_was_fitted(family, tmp_path):
    fitted = fit(family, ROWS.rows, ROWS.labels, seed=1, max_rows=1500 if family == "svm" else None)
    write(tmp_path / "some", fitted)
    classifier = load_model(tmp_path / "some").match
    others = np.random.default_rng(3).normal(scale=10, size=(500, 5)).astype(np.float32)
    for rows in (ROWS.rows, others, rows_on_thresholds(fitted) if family != "svm" else others):
        difference = np.abs(classifier.uncalibrated(rows) - fitted.probability(rows))
        assert difference.max() < 1e-6


def test_without_rounded_thresholds_values_on_them_would_fall_on_the_wrong_side():
    # Shows that the test above can fail: the same trees with LightGBM's own thresholds in double.
    X = np.round(ROWS.rows * 10) / 10
    data = lightgbm.Dataset(X, ROWS.labels.astype(np.float32), params={"verbosity": -1})
    settings = {"objective": "binary", "verbosity": -1, "num_threads": 1, "use_missing": False}
    raw = Boosted(lightgbm.train(settings, data, 30))
    rows = np.repeat(X, 3, axis=0).astype(np.float32)
    splits = thresholds_by_column(raw)
    for i in range(len(rows)):
        column, value = splits[i % len(splits)]
        rows[i, column] = np.float32(value)
    session = export_session(raw)
    difference = np.abs(session.run(None, {"rows": rows})[0] - raw.probability(rows))
    assert difference.max() > 1e-3


def export_session(fitted):
    import onnxruntime

    return onnxruntime.InferenceSession(to_onnx(fitted), providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("family", FAMILIES)
def test_graphs_carry_nothing_that_changes(family):
    fitted = fit(family, ROWS.rows, ROWS.labels, seed=1, max_rows=600)
    assert to_onnx(fitted) == to_onnx(fitted)
    model = onnx.load_from_string(to_onnx(fitted))
    assert (model.producer_name, model.producer_version, model.doc_string) == ("epiprior", "", "")
    assert model.graph.name == "epiprior"
    assert not model.metadata_props
    assert [item.name for item in model.graph.output] == ["probability"]


def test_another_class_is_refused():
    with pytest.raises(TypeError, match="no ONNX export for int"):
        to_onnx(3)


def test_a_folder_is_the_same_again(tmp_path):
    fitted = fit("tree", ROWS.rows, ROWS.labels, seed=1)
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        write(tmp_path / place / "some", fitted)
    files = sorted(path.name for path in (tmp_path / "a" / "some").iterdir())
    assert files == ["README.md", "manifest.json", "match.onnx", "two_keypoint.onnx"]
    for name in files:
        assert (tmp_path / "a" / "some" / name).read_bytes() == (tmp_path / "b" / "some" / name).read_bytes()


def test_the_manifest_says_everything(tmp_path):
    fitted = fit("tree", ROWS.rows, ROWS.labels, seed=1)
    write(tmp_path / "some", fitted, a=0.75, b=-0.5)
    manifest = load_model(tmp_path / "some").manifest
    assert manifest["name"] == "some"
    assert manifest["preset"] == "default"
    assert manifest["match"]["features"] == list(COLUMNS)
    assert manifest["match"]["calibration"] == {"a": 0.75, "b": -0.5}
    assert manifest["match"]["metrics"] == METRICS
    assert manifest["feature_parameters"] == {"max_keypoints": 4000}
    assert manifest["training_data"] == TRAINING_DATA
    assert manifest["library_versions"]["onnx"] == onnx.__version__
    assert set(manifest["files"]) == {"README.md", "match.onnx", "two_keypoint.onnx"}


def test_the_card_shows_the_measures(tmp_path):
    fitted = fit("tree", ROWS.rows, ROWS.labels, seed=1)
    write(tmp_path / "some", fitted)
    card = (tmp_path / "some" / "README.md").read_text()
    assert card.startswith("# epiprior model `some`\n")
    assert "| precision of the top 100 per pair | 0.7500 | 0.1250 | 0.7500 | 0.8750 |" in card
    assert "| precision at 0.5 | 0.5000 | - | - | - |" in card
    assert "12 rendered scenes" in card
    assert "{" not in card


# --- from the results of training


@pytest.fixture
def training_folder(tmp_path):
    folder = tmp_path / "training"
    folder.mkdir()
    parity, summary = {}, {"training_data": TRAINING_DATA}
    columns = {"two_keypoint": PAPER.two_keypoint_columns, "match": PAPER.match_columns}
    for target, names in columns.items():
        X = np.tile(ROWS.rows, (1, 2))[:, : len(names)].copy()
        fitted = fit("tree", X, ROWS.labels, seed=1)
        (folder / f"{target}.onnx").write_bytes(to_onnx(fitted))
        parity[f"{target}_rows"], parity[f"{target}_probability"] = X, fitted.probability(X)
        summary[target] = {"family": "tree", "columns": names, "a": 0.5, "b": 1.5, "metrics": METRICS}
    np.savez(folder / "parity.npz", **parity)
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_a_model_of_the_results_of_training(training_folder, tmp_path):
    export_model(training_folder, tmp_path / "models" / "paper", "paper")
    model = load_model(tmp_path / "models" / "paper")
    assert model.name == "paper"
    assert model.two_keypoint_columns == PAPER.two_keypoint_columns
    assert model.match_columns == PAPER.match_columns
    assert model.match.a == 0.5
    assert model.manifest["feature_parameters"]["two_keypoint_count"] == PAPER.two_keypoint_count
    assert model.manifest["feature_parameters"]["features"]["root"] is False


def test_a_model_that_says_something_else_is_not_exported(training_folder, tmp_path):
    with np.load(training_folder / "parity.npz") as stored:
        parity = dict(stored)
    parity["match_probability"] = parity["match_probability"] + 2e-6
    np.savez(training_folder / "parity.npz", **parity)
    with pytest.raises(ExportError, match=r"match.onnx: differs from the fitted classifier by 2e-06"):
        export_model(training_folder, tmp_path / "models" / "paper", "paper")


def test_stale_files_are_replaced(training_folder, tmp_path):
    export_model(training_folder, tmp_path / "paper", "paper")
    before = {path.name: path.read_bytes() for path in (tmp_path / "paper").iterdir()}
    (tmp_path / "paper" / "match.onnx").write_bytes(b"old")
    export_model(training_folder, tmp_path / "paper", "paper")
    assert {path.name: path.read_bytes() for path in (tmp_path / "paper").iterdir()} == before
