import csv
import io
import json
from dataclasses import dataclass

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.presets import PAPER
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.params import ExportedFamilies, TrainParams
from epiprior_lab.training import model_training
from epiprior_lab.training.classifiers import Sample, TargetRows, compare_families
from epiprior_lab.training.cross_validation import fit_without
from epiprior_lab.training.families import FAMILIES
from epiprior_lab.training.model_training import train_preset
from epiprior_lab.training.training_tables import (
    curves_csv,
    importances_csv,
    metrics_csv,
    seconds_csv,
    write_training,
)
from grouped_rows import COLUMNS, make_rows

ROWS = make_rows(1500)
CAPS = dict.fromkeys(FAMILIES, 600)


def target_rows():
    samples = [
        Sample.draw(
            scene=pair[:-2],
            pair=pair,
            rows=ROWS.X[ROWS.pair == pair],
            labels=ROWS.y[ROWS.pair == pair],
            most=50,
            seed=child_seed(0, pair),
        )
        for pair in np.unique(ROWS.pair).tolist()
    ]
    return TargetRows.stack("match", COLUMNS, samples)


def compare(store, workers=1, families=("tree", "lightgbm")):
    return compare_families(
        target_rows(),
        families=families,
        exported="tree",
        folds=3,
        seed=2,
        max_rows=CAPS,
        workers=workers,
        store=store,
    )


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


# --- samples


def test_a_sample_keeps_order_and_knows_its_share():
    data = target_rows()
    assert len(data.share) == 24
    for pair, share in data.share.items():
        size = np.count_nonzero(ROWS.pair == pair)
        here = data.rows[data.pair == pair]
        assert len(here) == min(50, size) == round(share * size)
        positions = [np.flatnonzero((row == ROWS.X).all(axis=1))[0] for row in here]
        assert positions == sorted(positions)
        assert set(data.scene[data.pair == pair].tolist()) == {pair[:-2]}


def test_the_digest_tells_rows_apart():
    data = target_rows()
    assert data.digest() == target_rows().digest()
    changed = target_rows()
    changed.labels[3] = ~changed.labels[3]
    assert data.digest() != changed.digest()


# --- comparison


def test_all_families_are_compared(tmp_path):
    found = compare(tmp_path, families=tuple(FAMILIES))
    assert found.calibration("tree").a > 0
    assert set(found.grouped) == set(found.refits) == set(FAMILIES)
    assert set(found.ungrouped) == {"tree"}
    assert not found.ungrouped["tree"].grouped
    assert found.ungrouped["tree"].family == "tree"
    for family in FAMILIES:
        assert found.grouped[family].family == family
        assert found.grouped[family].grouped
        assert found.grouped[family].probability.shape == found.data.labels.shape
        assert len(found.refits[family].parity_rows) == len(found.refits[family].parity_probability)


def test_two_workers_say_the_same_as_one(tmp_path):
    one, two = compare(tmp_path / "one"), compare(tmp_path / "two", workers=2)
    for make in (metrics_csv, curves_csv, importances_csv):
        assert make([one]) == make([two])
    assert one.refits["lightgbm"].onnx == two.refits["lightgbm"].onnx


def test_metrics_table(tmp_path):
    found = compare(tmp_path)
    rows = table(metrics_csv([found]))
    value = {(r["family"], r["grouped"], r["fold"], r["metric"]): float(r["value"]) for r in rows}
    assert len(value) == len(rows)
    grouped = found.grouped["tree"]
    assert value["tree", "true", "all", "precision_top_100"] == grouped.metrics["precision_top_100"]
    assert value["tree", "true", "2", "log_loss"] == grouped.fold_metrics[2]["log_loss"]
    assert value["tree", "true", "deviation", "log_loss"] == grouped.deviations()["log_loss"]
    assert value["tree", "true", "calibrated", "log_loss"] == grouped.calibrated_metrics["log_loss"]
    assert value["tree", "false", "all", "log_loss"] == found.ungrouped["tree"].metrics["log_loss"]
    assert ("tree", "false", "0", "precision_top_100") not in value
    assert not any("second" in metric for *_, metric in value)
    assert {r["fold"] for r in table(seconds_csv([found]))} == {"0", "1", "2"}


def test_curves_end_with_all_rows(tmp_path):
    found = compare(tmp_path, families=("tree",))
    rows = [r for r in table(curves_csv([found])) if r["grouped"] == "true"]
    curve = [r for r in rows if r["curve"] == "precision_recall"]
    assert float(curve[-1]["x"]) == 1
    assert int(curve[-1]["count"]) == len(found.data.labels)
    assert float(curve[-1]["y"]) == pytest.approx(found.data.labels.mean(), abs=1e-5)
    counts = [int(r["count"]) for r in rows if r["curve"] == "reliability_calibrated"]
    assert sum(counts) == len(found.data.labels)


def test_importances_table_leaves_out_the_svm(tmp_path):
    rows = table(importances_csv([compare(tmp_path, families=("tree", "svm"))]))
    assert [r["column"] for r in rows] == list(COLUMNS)
    assert {r["family"] for r in rows} == {"tree"}


# --- both classifiers of a preset


@dataclass
class FakeTwoKeypoints:
    descriptors: np.ndarray

    def select(self, columns):
        assert columns == PAPER.two_keypoint_columns
        return self.descriptors


@dataclass
class FakeRows:
    scene: str
    two_keypoints: FakeTwoKeypoints
    two_keypoint_labels: np.ndarray


PARAMS = TrainParams(
    seed=3,
    folds=3,
    families=("tree", "lightgbm"),
    exported=ExportedFamilies(paper="tree", default="lightgbm"),
    max_rows_per_pair=100,
    max_rows=800,
    max_forest_rows=400,
    max_svm_rows=400,
)


@pytest.fixture
def features(tmp_path, monkeypatch):
    """Files of pairs whose rows are made up; `votes` gets what the second classifier is made of."""
    folder, votes = tmp_path / "features", {}
    folder.mkdir()
    for pair in np.unique(ROWS.pair).tolist():
        (folder / f"{pair}.npz").write_bytes(pair.encode())

    def read_rows(file):
        here = ROWS.pair == file.stem
        X = np.column_stack([ROWS.X[here], ROWS.X[here][:, 0]])
        return FakeRows(file.stem[:-2], FakeTwoKeypoints(X), ROWS.y[here])

    def match_rows(rows, probability):
        X = rows.two_keypoints.descriptors
        votes[X.tobytes()] = probability
        return np.column_stack([probability, X[:, 1], X[:, 2]]).astype(np.float32), rows.two_keypoint_labels

    monkeypatch.setattr(model_training, "read_rows", read_rows)
    monkeypatch.setattr(model_training, "match_rows", match_rows)
    return folder, votes, read_rows


def train(features, tmp_path):
    return train_preset(features[0], "paper", PARAMS, workers=1, store=tmp_path / "store")


def test_votes_come_from_a_classifier_that_never_saw_the_scene(features, tmp_path):
    trained = train(features, tmp_path)
    first = trained.two_keypoint
    platt, validation = first.calibration("tree"), first.grouped["tree"]
    assert len(features[1]) == len(first.data.share) == 24
    for number in range(3):
        held = validation.fold == number
        seed = child_seed(PARAMS.seed, "two_keypoint")
        classifier = fit_without("tree", first.data.rows, first.data.labels, held, number, seed=seed, max_rows=800)
        for file in sorted(features[0].iterdir()):
            if file.stem[:-2] in set(first.data.scene[held].tolist()):
                rows = features[2](file).two_keypoints.descriptors
                expected = platt(classifier.probability(rows))
                np.testing.assert_array_equal(features[1][rows.tobytes()], expected)
                assert file.stem[:-2] not in set(first.data.scene[~held].tolist())


def test_what_training_writes(features, tmp_path):
    trained = train(features, tmp_path)
    for place in ("a", "b"):
        write_training(tmp_path / place, trained)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == [
        "curves.csv",
        "importances.csv",
        "match.onnx",
        "metrics.csv",
        "parity.npz",
        "summary.json",
        "two_keypoint.onnx",
    ]
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert summary["match"]["family"] == "tree"
    assert summary["match"]["columns"] == list(PAPER.match_columns)
    assert summary["training_data"]["scenes"] == 12
    assert summary["training_data"]["match_rows"] == len(trained.match.data.rows)
    assert set(summary["match"]["metrics"]["log_loss"]) == {"mean", "deviation", "calibrated", "ungrouped"}


def test_a_folder_without_rows_is_named(tmp_path):
    with pytest.raises(SettingsError, match="run the stage features first"):
        train_preset(tmp_path, "paper", PARAMS, workers=1, store=tmp_path)
