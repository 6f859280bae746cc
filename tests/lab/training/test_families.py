"""Families of classifiers: what is fitted, how it is smoothed and rounded, and what cannot be fitted."""

import warnings

import lightgbm
import numpy as np
import onnx
import onnxruntime
import pytest
from sklearn.svm import SVC
from sklearn.tree import DecisionTreeClassifier

from epiprior_lab.training import families
from epiprior_lab.training.families import (
    FAMILIES,
    TrainingError,
    fit,
    fit_svm,
    fit_tree,
    round_down,
    sample_by_class,
    to_onnx,
)
from grouped_rows import make_rows

pytestmark = pytest.mark.slow
ROWS = make_rows()


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_ranks_right_rows_first_and_its_bytes_depend_on_rows_and_seed_alone(family):
    fitted = fit(family, ROWS.rows, ROWS.labels, seed=1)
    probability = fitted.probability(ROWS.rows)
    assert (probability.dtype, probability.shape) == (np.float64, ROWS.labels.shape)
    assert probability.min() >= 0
    assert probability.max() <= 1
    assert probability[ROWS.labels].mean() > probability[~ROWS.labels].mean() + 0.2
    assert fitted.probability(ROWS.rows[:0]).shape == (0,)
    first, again, other = (fit(family, ROWS.rows, ROWS.labels, seed=k, max_rows=400) for k in (1, 1, 2))
    if family != "svm":
        first, again, other = map(to_onnx, (first, again, other))
    else:
        first, again, other = (fitted.weights.tobytes() for fitted in (first, again, other))
    assert first == again != other


def test_the_tree_is_pruned_and_its_leaves_smoothed_after_laplace():
    tree = fit_tree(ROWS.rows, ROWS.labels, seed=0).estimator
    leaf = tree.apply(ROWS.rows)
    probability = tree.predict_proba(ROWS.rows)
    for node in np.unique(leaf):
        here = ROWS.labels[leaf == node]
        np.testing.assert_allclose(probability[leaf == node, 1], (here.sum() + 1) / (len(here) + 2))
    np.testing.assert_allclose(probability.sum(axis=1), 1)
    grown = DecisionTreeClassifier(criterion="entropy", random_state=0).fit(ROWS.rows, ROWS.labels)
    assert fit_tree(ROWS.rows, ROWS.labels, seed=0).estimator.get_n_leaves() < grown.get_n_leaves() / 2


def test_thresholds_of_lightgbm_are_rounded_down_to_float32_and_change_nothing(monkeypatch):
    rounded = fit("lightgbm", ROWS.rows, ROWS.labels, seed=3)
    monkeypatch.setattr(families, "_float32_thresholds", lambda booster: booster)
    original = fit("lightgbm", ROWS.rows, ROWS.labels, seed=3)
    on_thresholds = np.repeat(ROWS.rows[:1], 5000, axis=0)
    thresholds = thresholds_of(original.booster)
    assert not all(t == float(np.float32(t)) for t in thresholds)  # otherwise this tests nothing
    assert all(t == float(np.float32(t)) for t in thresholds_of(rounded.booster))
    on_thresholds[:, 1] = np.resize(np.float32(thresholds), 5000)
    for rows in (ROWS.rows, on_thresholds):
        np.testing.assert_array_equal(rounded.probability(rows), original.probability(rows))
    values = np.array([0.1, -0.1, 1.0, 1 + 1e-12, -1 - 1e-12, 0.0, 1e-50, -1e-50, 1.0000000180025095e-35])
    rounded = round_down(values)
    assert rounded.dtype == np.float32
    assert (rounded.astype(float) <= values).all()
    assert (np.nextafter(rounded, np.float32(np.inf)).astype(float) > values).all()


def thresholds_of(booster: lightgbm.Booster) -> list[float]:
    return booster.trees_to_dataframe()["threshold"].dropna().tolist()


def test_the_decision_of_the_svm_is_libsvms_and_copes_with_a_constant_column():
    fitted = fit_svm(ROWS.rows[:800], ROWS.labels[:800], seed=2)
    svm = SVC(C=1.0, gamma=fitted.gamma)
    held = np.zeros(800, bool)
    held[sample_by_class(ROWS.labels[:800], 200, 2)] = True
    standardised = (ROWS.rows.astype(float) - fitted.mean) / fitted.scale
    svm.fit(standardised[:800][~held], ROWS.labels[:800][~held])
    np.testing.assert_allclose(fitted.decision(ROWS.rows), svm.decision_function(standardised), rtol=1e-9, atol=1e-9)
    X = ROWS.rows.copy()
    X[:, 4] = 7
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(fit("svm", X, ROWS.labels, seed=0, max_rows=500).probability(X)).all()


def test_importances_name_what_matters():
    for family in ("tree", "random-forest", "lightgbm"):
        importances = fit(family, ROWS.rows, ROWS.labels, seed=0).importances()
        assert importances.shape == (5,)
        assert importances.sum() == pytest.approx(1)
        assert importances[1] > importances[4]


def test_samples_keep_the_base_rate_both_classes_and_their_cap(monkeypatch):
    labels = np.arange(10_000) < 500
    kept = sample_by_class(labels, 1000, seed=0)
    assert len(kept) == len(set(kept.tolist())) == 1000
    assert labels[kept].sum() == 50
    assert (np.diff(kept) > 0).all()
    rare = np.arange(10_000) < 2
    assert rare[sample_by_class(rare, 100, seed=0)].sum() == 1
    seen = []
    monkeypatch.setitem(FAMILIES, "tree", lambda rows, labels, seed: seen.append(len(rows)))
    fit("tree", ROWS.rows, ROWS.labels, seed=0, max_rows=300)
    fit("tree", ROWS.rows, ROWS.labels, seed=0)
    assert seen == [300, len(ROWS.rows)]


def test_rows_that_cannot_be_trained_on_are_refused():
    for X, y, message in (
        (ROWS.rows, np.ones_like(ROWS.labels), "one class"),
        (ROWS.rows[:0], ROWS.labels[:0], "one class"),
        (np.where(ROWS.rows > 3, np.float32(np.nan), ROWS.rows), ROWS.labels, "NaN"),
    ):
        with pytest.raises(TrainingError, match=message):
            fit("tree", X, y, seed=0)


def exported(fitted, rows):
    session = onnxruntime.InferenceSession(to_onnx(fitted), providers=["CPUExecutionProvider"])
    return session.run(None, {"rows": rows})[0]


def splits_of(fitted):
    """Return (column, threshold) of every split of an exported ensemble of trees."""
    node = onnx.load_from_string(to_onnx(fitted)).graph.node[0]
    found = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
    splits = zip(found["nodes_featureids"], found["nodes_values"], found["nodes_modes"], strict=True)
    return [(column, np.float32(value)) for column, value, mode in splits if mode == b"BRANCH_LEQ"]


def rows_on_thresholds(fitted):
    """Return rows, each with one value exactly on a threshold, or one float32 above or below it."""
    splits = splits_of(fitted)
    rng = np.random.default_rng(0)
    rows = ROWS.rows[rng.integers(0, len(ROWS.rows), 4000)].copy()
    for i, split in enumerate(rng.integers(0, len(splits), 4000)):
        column, value = splits[split]
        rows[i, column] = (value, np.nextafter(value, np.float32(9)), np.nextafter(value, np.float32(-9)))[i % 3]
    return rows


@pytest.mark.parametrize("family", ["tree", "random-forest", "lightgbm"])
def test_a_graph_predicts_what_was_fitted_and_carries_nothing_that_changes(family):
    fitted = fit(family, ROWS.rows, ROWS.labels, seed=1, max_rows={"random-forest": 600}.get(family))
    others = np.random.default_rng(3).normal(scale=10, size=(500, 5)).astype(np.float32)
    for rows in (ROWS.rows, others, rows_on_thresholds(fitted)):
        assert np.abs(exported(fitted, rows) - fitted.probability(rows)).max() < 1e-6
    model = onnx.load_from_string(to_onnx(fitted))
    assert (model.producer_name, model.producer_version, model.doc_string) == ("epiprior", "", "")
    assert model.graph.name == "epiprior"
    assert not model.metadata_props
    assert [item.name for item in model.graph.output] == ["probability"]
