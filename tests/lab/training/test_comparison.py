"""Comparison of all families on both classifiers of both presets, on made-up rows, and their tables."""

import csv
import io
import json
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.presets import SECOND_ROUND_COLUMNS, find_preset
from epiprior.ranking.models import TARGETS, calibrate
from epiprior_lab.params import TrainParams
from epiprior_lab.training import comparison
from epiprior_lab.training.comparison import train
from epiprior_lab.training.samples import Sample, TargetRows
from epiprior_lab.training.tables import curves_csv, importances_csv, metrics_csv, write_training
from grouped_rows import COLUMNS, make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows(3000)
FAMILIES = ("tree", "svm", "lightgbm")
EXPORTED = {"paper": "tree", "default": "lightgbm", "confidence": "lightgbm"}
CAPS = {"max_rows_per_pair": 100, "max_rows": 600, "max_forest_rows": 400, "max_svm_rows": 400}
PARAMS = TrainParams(seed=3, folds=3, families=FAMILIES, exported=EXPORTED, **CAPS)


def drawn():
    parts = zip(ROWS.scenes.tolist(), ROWS.pairs.tolist(), ROWS.slices, strict=True)
    samples = [
        Sample.draw(scene=scene, pair=pair, rows=ROWS.rows[rows], labels=ROWS.labels[rows], most=100, seed=number)
        for number, (scene, pair, rows) in enumerate(parts)
    ]
    return TargetRows.stack("match", COLUMNS, samples)


def test_a_sample_keeps_order_and_share_and_its_digest_is_of_what_it_holds():
    data = drawn()
    assert len(data.pairs) == 24
    for kept, every, share in zip(data.slices, ROWS.slices, data.share, strict=True):
        here, rows = data.rows[kept], ROWS.rows[every]
        assert len(here) == min(100, len(rows)) == round(share * len(rows))
        positions = [np.flatnonzero((row == rows).all(axis=1))[0] for row in here]
        assert positions == sorted(positions)
    np.testing.assert_array_equal(data.scene, np.repeat(ROWS.scenes, data.lengths))
    assert data.digest() == drawn().digest()
    changed = drawn()
    changed.labels[3] = ~changed.labels[3]
    assert data.digest() != changed.digest()


def wide(rows, columns):
    return np.tile(rows, (1, len(columns)))[:, : len(columns)].astype(np.float32)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Train on files of pairs with made-up rows; also return the first classifier's votes by preset and pair."""
    root, votes = tmp_path_factory.mktemp("training"), {}
    folders = {preset: root / preset for preset in ("paper", "default")}
    for folder in folders.values():
        folder.mkdir(parents=True)
        for pair in ROWS.pairs.tolist():
            (folder / f"{pair}.npz").write_bytes(pair.encode())

    def read_rows(file):
        rows = ROWS.slices[ROWS.pairs.tolist().index(file.stem)]
        found = SimpleNamespace(select=lambda columns: wide(ROWS.rows[rows], columns))
        about = {"preset": file.parent.name, "pair": file.stem, "scene": file.stem[:-2]}
        return SimpleNamespace(**about, rows=rows, two_keypoints=found, two_keypoint_labels=ROWS.labels[rows])

    def voted_rows(found, first, second=None):
        columns = find_preset(found.preset).two_keypoint_columns
        votes[found.preset, found.pair] = first(found.two_keypoints.select(columns))
        described = np.column_stack([votes[found.preset, found.pair], ROWS.rows[found.rows]])
        matches = wide(described, find_preset(found.preset).match_columns)
        if second is not None:
            matches = wide(np.column_stack([second(matches), matches]), SECOND_ROUND_COLUMNS)
        return matches, found.two_keypoint_labels

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "read_rows", read_rows)
        patch.setattr(comparison, "voted_rows", voted_rows)
        patch.setenv("EPIPRIOR_WORKERS", "1")
        return {preset: train(preset, folder, PARAMS, root / "store") for preset, folder in folders.items()}, votes


def test_all_families_that_are_asked_for_are_compared(trained):
    trained, _ = trained
    assert list(trained) == ["paper", "default"]
    for preset, exported in (("paper", "tree"), ("default", "lightgbm")):
        targets = TARGETS if preset == "default" else TARGETS[:2]
        for found, target in zip(trained[preset], targets, strict=True):
            assert (found.model, found.exported, found.data.target) == (preset, exported, target)
            assert list(found.grouped) == [*FAMILIES]
            assert all(item.probability.shape == found.data.labels.shape for item in found.grouped.values())
            assert found.ungrouped.calibrated is None
            assert found.platt[0] > 0
            assert len(found.refit.parity_rows) == len(found.refit.parity_probability) == 2000


def test_votes_come_from_a_classifier_that_never_saw_the_scene(trained):
    trained, votes = trained
    for preset, (first, *_) in trained.items():
        found = first.grouped[first.exported]
        for pair, kept, every in zip(ROWS.pairs.tolist(), first.data.slices, ROWS.slices, strict=True):
            number = found.fold[kept][0]
            classifier = pickle.loads(found.classifiers[number])
            rows = wide(ROWS.rows[every], first.data.columns)
            np.testing.assert_array_equal(votes[preset, pair], calibrate(classifier.probability(rows), *first.platt))
            assert pair[:-2] not in set(first.data.scene[found.fold != number].tolist())


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_tables_and_what_else_training_writes_and_a_folder_without_rows_is_named(trained, tmp_path):
    trained, _ = trained
    found = trained["paper"][1]
    rows = table(metrics_csv([found]))
    value = {(r["family"], r["grouped"], r["fold"], r["metric"]): float(r["value"]) for r in rows}
    assert len(value) == len(rows)
    grouped = found.grouped["tree"]
    assert value["tree", "true", "all", "precision_top_100"] == grouped.metrics["precision_top_100"]
    assert value["tree", "true", "2", "log_loss"] == grouped.fold_metrics[2]["log_loss"]
    assert value["tree", "true", "deviation", "log_loss"] == grouped.deviations()["log_loss"]
    assert value["tree", "true", "calibrated", "log_loss"] == grouped.calibrated_metrics["log_loss"]
    assert value["tree", "false", "all", "log_loss"] == found.ungrouped.metrics["log_loss"]
    assert ("tree", "false", "0", "precision_top_100") not in value
    assert not any("second" in metric for *_, metric in value)
    rows = [r for r in table(curves_csv([found])) if (r["family"], r["grouped"]) == ("tree", "true")]
    curve = [r for r in rows if r["curve"] == "precision_recall"]
    assert (float(curve[-1]["x"]), int(curve[-1]["count"])) == (1, len(found.data.labels))
    assert float(curve[-1]["y"]) == pytest.approx(found.data.labels.mean(), abs=1e-5)
    assert float(curve[0]["y"]) > float(curve[-1]["y"])
    assert sum(int(r["count"]) for r in rows if r["curve"] == "reliability_calibrated") == len(found.data.labels)
    rows = table(importances_csv(trained["default"]))
    assert [r["column"] for r in rows if r["target"] == "match"] == list(find_preset("default").match_columns)
    assert {r["family"] for r in rows} == {"lightgbm"}
    write_training(tmp_path / "a", trained["paper"])
    tables = {"curves.csv", "importances.csv", "match.onnx", "metrics.csv", "parity.npz", "summary.json"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == {*tables, "two_keypoint.onnx"}
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert summary["match"]["family"] == "tree"
    assert summary["match"]["columns"] == list(find_preset("paper").match_columns)
    assert summary["training_data"]["scenes"] == 12
    assert summary["training_data"]["match_rows"] == len(trained["paper"][1].data.rows)
    assert set(summary["match"]["metrics"]["log_loss"]) == {"mean", "deviation", "calibrated", "ungrouped"}
    with pytest.raises(SettingsError, match="run the stage features first"):
        train("paper", tmp_path, PARAMS, tmp_path)
