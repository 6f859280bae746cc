import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from epiprior_lab.training import cross_validation as training
from epiprior_lab.training.cross_validation import METRICS, cross_validate, folds_by_row, folds_by_scene
from epiprior_lab.training.families import FAMILIES, TrainingError
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows()


def validate(family="lightgbm", by_scene=True, **changes):
    fold = folds_by_scene(ROWS.labels, ROWS.scene, 4, 7) if by_scene else folds_by_row(ROWS.labels, 4, 7)
    return cross_validate(family, ROWS, fold, by_scene=by_scene, seed=7, **changes)


def test_no_scene_is_in_two_folds_and_folds_of_few_or_uneven_scenes_and_of_rows():
    for seed in range(5):
        fold = folds_by_scene(ROWS.labels, ROWS.scene, 5, seed)
        assert set(fold.tolist()) == set(range(5))
        assert all(len(set(fold[ROWS.scene == name].tolist())) == 1 for name in ROWS.scenes)
    with pytest.raises(TrainingError, match="3 scenes for 4 folds"):
        folds_by_scene(ROWS.labels[:9], np.repeat(["a", "b", "c"], 3), 4, 0)
    scene = np.repeat([f"{i}" for i in range(6)], [5000, 10, 10, 10, 10, 10])
    fold = folds_by_scene(np.arange(len(scene)) % 7 == 0, scene, 6, 0)
    assert len(np.unique(fold)) == 6
    fold = folds_by_row(ROWS.labels, 10, 0)
    shares = [ROWS.labels[fold == number].mean() for number in range(10)]
    assert max(shares) - min(shares) < 0.01
    assert len(np.unique(fold[ROWS.scene == "scene-00"])) == 10
    with pytest.raises(TrainingError, match="rarer class"):
        folds_by_row(np.arange(100) < 3, 10, 0)


@pytest.mark.parametrize("by_scene", [True, False])
def test_a_classifier_never_sees_the_scenes_that_it_is_measured_on(monkeypatch, by_scene):
    # The level column tells the scene; remember which are trained on and which predicted in each fold.
    trained, predicted = [], []

    def scenes_of(rows):
        return set(np.round(rows[:, 3]).tolist())

    def probability(rows):
        predicted.append(scenes_of(rows))
        return np.linspace(0.1, 0.9, len(rows))

    def spy(rows, labels, seed):
        trained.append(scenes_of(rows))
        return SimpleNamespace(probability=probability)

    monkeypatch.setitem(FAMILIES, "tree", spy)
    monkeypatch.setattr(training, "cross_calibrate", lambda probability, labels, fold: probability)
    validate("tree", by_scene=by_scene)
    assert len(trained) == len(predicted) == 4
    assert [bool(seen & measured) for seen, measured in zip(trained, predicted, strict=True)] == [not by_scene] * 4


def test_all_is_the_same_again_with_metrics_of_folds_and_of_all():
    first, second = validate("random-forest", max_rows=200), validate("random-forest", max_rows=200)
    np.testing.assert_array_equal(first.probability, second.probability)
    np.testing.assert_array_equal(first.calibrated, second.calibrated)
    assert (first.metrics, first.fold_metrics) == (second.metrics, second.fold_metrics)
    found = validate("tree", keep=True)
    assert len(found.classifiers) == 4
    for number, classifier in enumerate(found.classifiers):
        held = found.fold == number
        np.testing.assert_array_equal(found.probability[held], pickle.loads(classifier).probability(ROWS.rows[held]))
    found = validate("tree")
    assert found.classifiers == ()
    assert set(found.metrics) == set(METRICS) == set(found.calibrated_metrics)
    assert len(found.fold_metrics) == len(found.seconds_per_10000_rows) == 4
    assert all(set(fold) == set(METRICS) for fold in found.fold_metrics)
    losses = [fold["log_loss"] for fold in found.fold_metrics]
    assert np.average(losses, weights=np.bincount(found.fold)) == pytest.approx(found.metrics["log_loss"])
    pairs = np.bincount([found.fold[rows][0] for rows in ROWS.slices])
    tops = [fold["precision_top_100"] for fold in found.fold_metrics]
    assert np.average(tops, weights=pairs) == pytest.approx(found.metrics["precision_top_100"])
    assert found.deviations()["log_loss"] == pytest.approx(np.std(losses, ddof=1))
    assert all(seconds > 0 for seconds in found.seconds_per_10000_rows)
    found = validate("tree", by_scene=False)
    assert all("precision_top_100" not in fold for fold in found.fold_metrics)
    assert 0 < found.metrics["precision_top_100"] < 1
    assert np.isnan(found.deviations()["precision_top_100"])
    assert found.calibrated is None
    assert found.calibrated_metrics == {}
