import numpy as np
import pytest
from sklearn.metrics import average_precision_score, brier_score_loss, log_loss

from epiprior.errors import SettingsError
from epiprior_lab.training import cross_validation as training
from epiprior_lab.training.cross_validation import cross_validate, fit_final, fit_without, folds_by_row, folds_by_scene
from epiprior_lab.training.families import FAMILIES, TrainingError
from epiprior_lab.training.metrics import (
    METRICS,
    average_precision,
    precision_of_top,
    precision_recall,
    ranking_metrics,
    row_metrics,
)
from grouped_rows import COLUMNS, make_rows

ROWS = make_rows()


def validate(family="lightgbm", rows=ROWS, **changes):
    settings = {"columns": COLUMNS, "folds": 4, "seed": 7, **changes}
    return cross_validate(family, rows.X, rows.y, rows.scene, rows.pair, **settings)


# --- folds


@pytest.mark.parametrize("seed", range(5))
def test_no_scene_is_in_two_folds(seed):
    fold = folds_by_scene(ROWS.y, ROWS.scene, 5, seed)
    assert set(fold.tolist()) == set(range(5))
    for name in np.unique(ROWS.scene):
        assert len(set(fold[ROWS.scene == name].tolist())) == 1


def test_a_classifier_never_sees_the_scenes_that_it_is_measured_on(monkeypatch):
    # The level column tells the scene; remember which are trained on and which predicted in each fold.
    trained, predicted = [], []

    class Spy:
        width = 5

        def probability(self, rows):
            predicted.append(set(np.round(rows[:, 3]).tolist()))
            return np.linspace(0.1, 0.9, len(rows))

        def importances(self):
            return None

    def spy(rows, labels, seed):
        trained.append(set(np.round(rows[:, 3]).tolist()))
        return Spy()

    monkeypatch.setitem(FAMILIES, "tree", spy)
    monkeypatch.setattr(training, "cross_calibrate", lambda probability, labels, fold: probability)
    validate("tree")
    assert len(trained) == len(predicted) == 4
    for seen, measured in zip(trained, predicted, strict=True):
        assert not seen & measured
    trained.clear()
    predicted.clear()
    validate("tree", grouped=False)
    assert all(seen & measured for seen, measured in zip(trained, predicted, strict=True))


def test_fewer_scenes_than_folds_are_refused():
    with pytest.raises(TrainingError, match="3 scenes for 4 folds"):
        folds_by_scene(ROWS.y[:9], np.repeat(["a", "b", "c"], 3), 4, 0)


def test_every_fold_gets_a_scene_where_sizes_are_uneven():
    scene = np.repeat([f"{i}" for i in range(6)], [5000, 10, 10, 10, 10, 10])
    labels = np.arange(len(scene)) % 7 == 0
    fold = folds_by_scene(labels, scene, 6, 0)
    assert len(np.unique(fold)) == 6


def test_ungrouped_folds_split_scenes_and_balance_classes():
    fold = folds_by_row(ROWS.y, 10, 0)
    shares = [ROWS.y[fold == number].mean() for number in range(10)]
    assert max(shares) - min(shares) < 0.01
    assert len(np.unique(fold[ROWS.scene == "scene-00"])) == 10
    with pytest.raises(TrainingError, match="rarer class"):
        folds_by_row(np.arange(100) < 3, 10, 0)


# --- cross-validation


def test_splitting_scenes_leaks():
    grouped, leaking = validate(), validate(grouped=False)
    assert leaking.metrics["log_loss"] < grouped.metrics["log_loss"] - 0.02
    assert leaking.metrics["average_precision"] > 0.3


def test_everything_but_times_is_the_same_again():
    first, second = validate("random-forest", max_rows=500), validate("random-forest", max_rows=500)
    np.testing.assert_array_equal(first.probability, second.probability)
    np.testing.assert_array_equal(first.calibrated, second.calibrated)
    np.testing.assert_array_equal(first.fold, second.fold)
    assert first.metrics == second.metrics
    assert first.fold_metrics == second.fold_metrics


def test_out_of_fold_probabilities_are_those_of_the_folds_classifier():
    found = validate("tree")
    held = found.fold == 2
    again = fit_without("tree", ROWS.X, ROWS.y, held, 2, seed=7)
    np.testing.assert_array_equal(found.probability[held], again.probability(ROWS.X[held]))


def test_metrics_of_folds_and_of_all():
    found = validate("tree")
    assert set(found.metrics) == set(METRICS) == set(found.calibrated_metrics)
    assert len(found.fold_metrics) == len(found.seconds_per_10000_rows) == 4
    assert all(set(fold) == set(METRICS) for fold in found.fold_metrics)
    weights = np.bincount(found.fold)
    losses = [fold["log_loss"] for fold in found.fold_metrics]
    assert np.average(losses, weights=weights) == pytest.approx(found.metrics["log_loss"])
    assert found.deviations()["log_loss"] == pytest.approx(np.std(losses, ddof=1))
    assert not any("second" in name for name in found.metrics)
    assert all(seconds > 0 for seconds in found.seconds_per_10000_rows)


def test_ungrouped_folds_have_no_ranking_metrics_of_their_own():
    found = validate("tree", grouped=False)
    assert all("precision_top_100" not in fold for fold in found.fold_metrics)
    assert 0 < found.metrics["precision_top_100"] < 1
    assert np.isnan(found.deviations()["precision_top_100"])


def test_the_final_refit_takes_all_rows():
    final = fit_final("tree", ROWS.X, ROWS.y, seed=7)
    assert final.estimator.tree_.n_node_samples[0] == len(ROWS.X)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"folds": 1}, SettingsError),
        ({"folds": 13}, TrainingError),
        ({"columns": COLUMNS[:-1]}, TrainingError),
    ],
)
def test_bad_requests_are_refused(changes, error):
    with pytest.raises(error):
        validate("tree", **changes)


# --- metrics


def test_precision_of_the_top_by_hand():
    labels = np.array([True, False, True, True, False])
    probability = np.array([0.9, 0.8, 0.7, 0.6, 0.5])
    assert precision_of_top(probability, labels, 2) == 0.5
    assert precision_of_top(probability, labels, 3) == pytest.approx(2 / 3)
    assert precision_of_top(probability, labels, 100) == pytest.approx(3 / 5)
    assert np.isnan(precision_of_top(np.empty(0), np.empty(0, bool), 100))


def test_ties_count_in_part_whatever_their_order():
    labels = np.array([True, True, True, False])
    probability = np.array([0.9, 0.5, 0.5, 0.5])
    expected = (1 + 2 / 3) / 2
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [3, 0, 1, 2]):
        assert precision_of_top(probability[order], labels[order], 2) == pytest.approx(expected)


def test_average_precision_is_scikit_learns():
    rng = np.random.default_rng(0)
    labels = rng.random(500) < 0.2
    probability = np.round(rng.random(500) * 0.5 + 0.3 * labels, 2)  # with ties
    assert average_precision(probability, labels) == pytest.approx(average_precision_score(labels, probability))
    assert np.isnan(average_precision(probability, np.zeros(500, bool)))


def test_precision_and_recall_end_with_all_rows():
    precision, recall, threshold = precision_recall(ROWS.X[:, 1].astype(float), ROWS.y)
    assert recall[-1] == 1
    assert precision[-1] == pytest.approx(ROWS.y.mean())
    assert (np.diff(threshold) < 0).all()
    empty = precision_recall(np.empty(0), np.empty(0, bool))
    assert all(len(part) == 0 for part in empty)


def test_every_pair_counts_the_same():
    pair = np.repeat(["a", "b", "c"], [300, 2, 2])
    labels = np.concatenate([np.ones(300, bool), [False, True], [False, False]])
    probability = np.concatenate([np.ones(300), [0.9, 0.1], [0.5, 0.4]])
    found = ranking_metrics(probability, labels, pair)
    assert found["precision_top_100"] == pytest.approx((1 + 0.5 + 0) / 3)
    assert found["average_precision"] == pytest.approx((1 + 0.5) / 2)
    assert all(np.isnan(value) for value in ranking_metrics(np.empty(0), np.empty(0, bool), pair[:0]).values())


def test_a_sample_estimates_the_top_of_all_rows():
    rng = np.random.default_rng(1)
    size = 20_000
    labels = rng.random(size) < 0.05
    probability = rng.normal(size=size) + 2.5 * labels
    whole = ranking_metrics(probability, labels, np.full(size, "a"))["precision_top_100"]
    estimates = []
    for _ in range(50):
        kept = rng.choice(size, 4000, replace=False)
        sample = ranking_metrics(probability[kept], labels[kept], np.full(4000, "a"), {"a": 0.2})
        estimates.append(sample["precision_top_100"])
    assert np.mean(estimates) == pytest.approx(whole, abs=0.03)
    unscaled = ranking_metrics(probability[kept], labels[kept], np.full(4000, "a"))["precision_top_100"]
    assert unscaled < whole - 0.05


def test_row_metrics_are_scikit_learns():
    rng = np.random.default_rng(2)
    labels = rng.random(400) < 0.3
    probability = np.clip(0.3 + 0.3 * labels + 0.2 * rng.normal(size=400), 0.001, 0.999)
    found = row_metrics(probability, labels)
    assert found["log_loss"] == pytest.approx(log_loss(labels, probability))
    assert found["brier_score"] == pytest.approx(brier_score_loss(labels, probability))
    assert found["accuracy"] == pytest.approx(np.mean((probability > 0.5) == labels))
    assert found["precision"] == pytest.approx(labels[probability > 0.5].mean())
    assert np.isnan(row_metrics(np.full(3, 0.1), np.zeros(3, bool))["precision"])
    assert all(np.isnan(value) for value in row_metrics(np.empty(0), np.empty(0, bool)).values())
