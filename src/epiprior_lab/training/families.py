"""The families of classifiers that are compared: each is a function that fits a `Fitted` in one thread.

As an ONNX graph, the same bytes in every run, trees take ``rows`` (N, C) and give ``probability`` (N,), float32.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import lightgbm
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from scipy.special import expit
from sklearn.ensemble import RandomForestClassifier
from sklearn.svm import SVC
from sklearn.tree import DecisionTreeClassifier

from epiprior.errors import EpipriorError
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray
from epiprior_lab.training.calibration import fit_sigmoid

_LIGHTGBM_ROUNDS = 100
_LIGHTGBM: dict[str, Any] = {
    "objective": "binary",
    "num_leaves": 31,
    "learning_rate": 0.05,
    "lambda_l2": 1.0,
    "feature_fraction": 0.5,
    "use_missing": False,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 1,
    "verbosity": -1,
}
_SVM_CHUNK = 4096
_OPSET, _ML_OPSET, _IR_VERSION = 17, 3, 9
_LIGHTGBM_OPSET = 15  # the highest that its converter knows; only the attributes of the trees are kept


class TrainingError(EpipriorError, ValueError):
    """Rows cannot be trained on: one class only, or a value that is not finite."""


@dataclass(frozen=True)
class Trees:
    """A tree or a forest of scikit-learn."""

    estimator: DecisionTreeClassifier | RandomForestClassifier

    def probability(self, rows: Float32Array) -> FloatArray:
        """Return the probability of the right class, shape (N,), float64, in [0, 1]; N = 0 is allowed."""
        return np.asarray(self.estimator.predict_proba(rows)[:, 1], np.float64) if len(rows) else np.empty(0)

    def importances(self) -> FloatArray:
        """Return the decrease of impurity by each column, shape (C,), sum 1."""
        return np.asarray(self.estimator.feature_importances_, np.float64)


@dataclass(frozen=True)
class Boosted:
    """A booster of LightGBM whose thresholds are float32 numbers."""

    booster: lightgbm.Booster

    def probability(self, rows: Float32Array) -> FloatArray:
        """Return the probability of the right class."""
        return np.asarray(self.booster.predict(rows, num_threads=1), np.float64) if len(rows) else np.empty(0)

    def importances(self) -> FloatArray:
        """Return the gain by each column, shape (C,), sum 1."""
        gain = np.asarray(self.booster.feature_importance("gain"), np.float64)
        return gain / max(float(gain.sum()), np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class SupportVectors:
    """An SVM with Gaussian kernel on standardised columns, and Platt's sigmoid of its decision value.

    With ``x = (row - mean) / scale`` and the standardised support vectors v_s, shape (S, C), the decision value is
    ``sum_s weights_s exp(-gamma |x - v_s|^2) + intercept``. The sigmoid's a and b are fitted on rows held out.
    """

    mean: FloatArray
    scale: FloatArray
    vectors: FloatArray
    weights: FloatArray
    intercept: float
    gamma: float
    a: float = 1.0
    b: float = 0.0

    def decision(self, rows: Float32Array) -> FloatArray:
        """Return the decision value of each row, shape (N,); libsvm's own, but by BLAS and much faster."""
        result = np.empty(len(rows))
        norms = np.sum(self.vectors**2, axis=1)
        for start in range(0, len(rows), _SVM_CHUNK):
            part = slice(start, start + _SVM_CHUNK)
            x = (rows[part].astype(np.float64) - self.mean) / self.scale
            squared = np.sum(x**2, axis=1)[:, None] + norms - 2 * x @ self.vectors.T
            result[part] = np.exp(-self.gamma * squared) @ self.weights + self.intercept
        return result

    def probability(self, rows: Float32Array) -> FloatArray:
        """Return the probability of the right class."""
        return np.asarray(expit(self.a * self.decision(rows) + self.b), np.float64)


Fitted = Trees | Boosted | SupportVectors


def fit_tree(rows: Float32Array, labels: BoolArray, seed: int) -> Fitted:
    """Fit the paper's classifier (section 4.4), a decision tree like C4.5.

    Like C4.5 it splits by information and smooths its leaves after Laplace, ``(n1 + 1) / (n + 2)``. Unlike C4.5, which
    prunes by a pessimistic estimate of the error, it prunes by cost and complexity.
    """
    tree = DecisionTreeClassifier(
        criterion="entropy", min_samples_leaf=max(20, len(rows) // 2000), ccp_alpha=2e-5, random_state=seed
    ).fit(rows, labels)
    # The tree's own values are changed, so that whatever reads them, predict_proba or an exporter, agrees.
    nodes = tree.tree_
    count = np.asarray(nodes.weighted_n_node_samples)[:, None]
    nodes.value[:, 0, :] = (nodes.value[:, 0, :] * count + 1) / (count + 2)
    return Trees(tree)


def fit_forest(rows: Float32Array, labels: BoolArray, seed: int) -> Fitted:
    """Fit a random forest of 50 trees."""
    forest = RandomForestClassifier(
        n_estimators=50, min_samples_leaf=5, max_features="sqrt", n_jobs=1, random_state=seed
    )
    return Trees(forest.fit(rows, labels))


def fit_lightgbm(rows: Float32Array, labels: BoolArray, seed: int) -> Fitted:
    """Fit gradient-boosted trees: 100 rounds, 31 leaves; 50,000 rows then take about 0.1 s in onnxruntime."""
    data = lightgbm.Dataset(rows, labels.astype(np.float32), params={"verbosity": -1})
    settings = {**_LIGHTGBM, "seed": seed, "min_data_in_leaf": min(300, max(20, len(rows) // 200))}
    return Boosted(_float32_thresholds(lightgbm.train(settings, data, _LIGHTGBM_ROUNDS)))


def fit_svm(rows: Float32Array, labels: BoolArray, seed: int) -> Fitted:
    """Fit an SVM with Gaussian kernel on three quarters of the rows, and Platt's sigmoid on the rest.

    Training takes time cubic in the rows, hence ``max_svm_rows``. ``SVC(probability=True)``, which scikit-learn
    deprecates, would refit the SVM five times.
    """
    held = np.zeros(len(rows), bool)
    held[sample_by_class(labels, max(2, len(rows) // 4), seed)] = True
    mean = rows.mean(axis=0, dtype=np.float64)
    scale = rows.std(axis=0, dtype=np.float64)
    scale[scale == 0] = 1.0
    gamma = 1.0 / rows.shape[1]
    svm = SVC(C=1.0, gamma=gamma, cache_size=500)
    svm.fit((rows[~held].astype(np.float64) - mean) / scale, labels[~held])
    fitted = SupportVectors(mean, scale, svm.support_vectors_, svm.dual_coef_[0], float(svm.intercept_[0]), gamma)
    a, b = fit_sigmoid(fitted.decision(rows[held]), labels[held])
    return replace(fitted, a=a, b=b)


# The slowest first: the last task to end decides how long all take.
FAMILIES: dict[str, Callable[[Float32Array, BoolArray, int], Fitted]] = {
    "random-forest": fit_forest,
    "svm": fit_svm,
    "lightgbm": fit_lightgbm,
    "tree": fit_tree,
}


def fit(family: str, rows: Float32Array, labels: BoolArray, *, seed: int, max_rows: int | None = None) -> Fitted:
    """Fit a family to at most `max_rows` rows; TrainingError if rows cannot be trained on."""
    if max_rows is not None and max_rows < len(rows):
        kept = sample_by_class(labels, max_rows, seed)
        rows, labels = rows[kept], labels[kept]
    if not np.isfinite(rows).all():
        column = int(np.argwhere(~np.isfinite(rows))[0, 1])
        raise TrainingError(f"rows to train on: NaN or infinite value in column {column}")
    if labels.all() or not labels.any():
        raise TrainingError(f"{len(labels)} rows to train on are all of one class")
    return FAMILIES[family](rows, labels.astype(bool), seed)


def sample_by_class(labels: BoolArray, size: int, seed: int) -> IntArray:
    """Return the indices, ascending, of about `size` rows: classes in proportion, one of each at least."""
    rng = np.random.default_rng(seed)
    kept = []
    for value in (False, True):
        rows = np.flatnonzero(labels == value)
        wanted = min(len(rows), max(1, round(size * len(rows) / max(1, len(labels)))))
        kept.append(rng.choice(rows, wanted, replace=False) if wanted else rows)
    return np.sort(np.concatenate(kept)).astype(np.int64)


def _float32_thresholds(booster: lightgbm.Booster) -> lightgbm.Booster:
    """Round every threshold down to float32, which ONNX keeps exactly; no comparison with a float32 value changes."""

    def rounded(match: re.Match[str]) -> str:
        thresholds = np.array(match[2].split(), np.float64)
        return match[1] + " ".join(f"{t:.17g}" for t in round_down(thresholds).astype(np.float64))

    # A changed length of the text makes the sizes of the trees in it wrong; they are optional.
    text = re.sub(r"^(threshold=)(.*)$", rounded, booster.model_to_string(), flags=re.MULTILINE)
    text = re.sub(r"^tree_sizes=.*\n", "", text, flags=re.MULTILINE)
    return lightgbm.Booster(model_str=text)


def round_down(values: FloatArray) -> Float32Array:
    """Return the largest float32 not above each value."""
    nearest = values.astype(np.float32)
    return np.where(nearest.astype(np.float64) > values, np.nextafter(nearest, np.float32(-np.inf)), nearest)


def to_onnx(fitted: Trees | Boosted) -> bytes:
    """Return a serialised graph whose probabilities equal ``fitted.probability`` to 1e-6 on any finite float32 rows."""
    import onnxmltools
    import skl2onnx
    from onnxmltools.convert.common import data_types
    from skl2onnx.common.data_types import FloatTensorType

    if isinstance(fitted, Trees):
        width, opset = fitted.estimator.n_features_in_, {"": _OPSET, "ai.onnx.ml": _ML_OPSET}
        types, options = [("rows", FloatTensorType([None, width]))], {"zipmap": False}
        converted = skl2onnx.convert_sklearn(fitted.estimator, initial_types=types, options=options, target_opset=opset)
        return _tree_graph(converted, width, logistic=False)
    width = fitted.booster.num_feature()
    how = {"initial_types": [("rows", data_types.FloatTensorType([None, width]))], "zipmap": False}
    converted = onnxmltools.convert_lightgbm(fitted.booster, target_opset=_LIGHTGBM_OPSET, **how)
    return _tree_graph(converted, width, logistic=True)


def _tree_graph(converted: onnx.ModelProto, width: int, *, logistic: bool) -> bytes:
    """Rebuild a classifier as the sum of its trees, without marks of missing values, which slow the runtime down."""
    (node,) = [node for node in converted.graph.node if node.op_type == "TreeEnsembleClassifier"]
    found = {item.name: helper.get_attribute_value(item) for item in node.attribute}
    # Converters of scikit-learn give a weight to both classes, that of LightGBM gives the logit as class 0.
    kept = np.flatnonzero(np.array(found["class_ids"]) == max(found["class_ids"]))
    dropped = ("nodes_missing_value_tracks_true", "nodes_hitrates")
    splits = {key: value for key, value in found.items() if key.startswith("nodes_") and key not in dropped}
    keys = ("nodeids", "treeids", "weights")
    targets: dict[str, Any] = {f"target_{key}": [found[f"class_{key}"][i] for i in kept] for key in keys}
    targets |= {"target_ids": [0] * len(kept), "n_targets": 1}
    how = {"domain": "ai.onnx.ml", "aggregate_function": "SUM", "post_transform": "NONE"}
    trees = helper.make_node("TreeEnsembleRegressor", ["rows"], ["sum"], **how, **targets, **splits)
    flat = helper.make_node("Reshape", ["sum", "flat"], ["logit" if logistic else "probability"])
    nodes = [trees, flat] + ([helper.make_node("Sigmoid", ["logit"], ["probability"])] if logistic else [])
    for node in nodes:
        node.name = node.output[0]
    graph = helper.make_graph(
        nodes,
        "epiprior",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, width])],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, [None])],
        [numpy_helper.from_array(np.array([-1], np.int64), "flat")],
    )
    # Nothing in the model changes from run to run.
    opsets = [helper.make_opsetid("", _OPSET), helper.make_opsetid("ai.onnx.ml", _ML_OPSET)]
    model = helper.make_model(graph, producer_name="epiprior", ir_version=_IR_VERSION, opset_imports=opsets)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))
