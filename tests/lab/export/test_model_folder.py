import json

import numpy as np
import onnx
import pytest

from epiprior.presets import PAPER
from epiprior.ranking.models import load_model
from epiprior_lab.export.model_folder import ExportError, export_model
from epiprior_lab.training.families import fit, to_onnx
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows()
TRAINING_DATA = {"sha256": "ab" * 32, "scenes": 12, "rankings": 24}
TRAINING_DATA |= {"two_keypoint_rows": 2400, "two_keypoint_right": 700, "match_rows": 2000, "match_right": 300}
METRICS = {
    "precision_top_100": {"mean": 0.75, "deviation": 0.125, "calibrated": 0.75, "ungrouped": 0.875},
    "precision": {"mean": 0.5},
}


@pytest.fixture
def training(tmp_path):
    """Return what training writes: two trees on as many columns as the preset `paper` has."""
    folder = tmp_path / "training"
    folder.mkdir()
    parity, summary = {}, {"training_data": TRAINING_DATA}
    for target, names in {"two_keypoint": PAPER.two_keypoint_columns, "match": PAPER.match_columns}.items():
        X = np.tile(ROWS.rows, (1, 2))[:, : len(names)].copy()
        fitted = fit("tree", X, ROWS.labels, seed=1)
        (folder / f"{target}.onnx").write_bytes(to_onnx(fitted))
        parity[f"{target}_rows"], parity[f"{target}_probability"] = X, fitted.probability(X)
        summary[target] = {"family": "tree", "columns": names, "a": 0.5, "b": 1.5, "metrics": METRICS}
    np.savez(folder / "parity.npz", **parity)
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_the_library_loads_the_folder_and_its_card_and_stale_files_are_replaced(training, tmp_path):
    folder = tmp_path / "models" / "some"
    export_model(training, folder, "paper")
    model = load_model(folder)
    assert model.name == "some"
    assert model.two_keypoint.columns == PAPER.two_keypoint_columns
    assert model.match.columns == PAPER.match_columns
    assert (model.match.a, model.match.b) == (0.5, 1.5)
    manifest = model.manifest
    assert (manifest["preset"], manifest["training_data"]) == ("paper", TRAINING_DATA)
    wanted = {"family": "tree", "calibration": {"a": 0.5, "b": 1.5}, "metrics": METRICS}
    assert manifest["match"].items() >= wanted.items()
    assert manifest["feature_parameters"]["two_keypoint_count"] == PAPER.two_keypoint_count
    assert manifest["feature_parameters"]["features"]["root"] is False
    assert manifest["library_versions"]["onnx"] == onnx.__version__
    assert set(manifest["files"]) == {"README.md", "match.onnx", "two_keypoint.onnx"}
    card = (folder / "README.md").read_text()
    assert card.startswith("# epiprior model `some`\n")
    assert "| precision of the top 100 per pair | 0.7500 | 0.1250 | 0.7500 | 0.8750 |" in card
    assert "| precision at 0.5 | 0.5000 | - | - | - |" in card
    assert "12 rendered scenes" in card
    assert "{" not in card
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(before) == ["README.md", "manifest.json", "match.onnx", "two_keypoint.onnx"]
    (folder / "match.onnx").write_bytes(b"old")
    export_model(training, folder, "paper")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_model_that_gives_other_probabilities_is_not_exported(training, tmp_path):
    with np.load(training / "parity.npz") as stored:
        parity = dict(stored)
    parity["match_probability"] = parity["match_probability"] + 2e-6
    np.savez(training / "parity.npz", **parity)
    with pytest.raises(ExportError, match=r"match.onnx: differs from the fitted classifier by 2e-06"):
        export_model(training, tmp_path / "models" / "paper", "paper")
