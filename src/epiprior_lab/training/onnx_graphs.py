"""Fitted classifiers as ONNX graphs, the same bytes in every run: ``rows`` (N, C), ``probability`` (N,), float32."""

import functools
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from epiprior_lab.training.families import Boosted, Fitted, SupportVectors, Trees

_OPSET, _ML_OPSET, _IR_VERSION = 17, 3, 9


@functools.singledispatch
def to_onnx(fitted: Fitted) -> bytes:
    """Return a serialised graph whose probabilities equal ``fitted.probability`` to 1e-6 on any finite float32 rows."""
    raise TypeError(f"no ONNX export for {type(fitted).__name__}")


@to_onnx.register
def _(fitted: Trees) -> bytes:
    import skl2onnx
    from skl2onnx.common.data_types import FloatTensorType

    width, opset = fitted.estimator.n_features_in_, {"": _OPSET, "ai.onnx.ml": _ML_OPSET}
    types, options = [("rows", FloatTensorType([None, width]))], {"zipmap": False}
    converted = skl2onnx.convert_sklearn(fitted.estimator, initial_types=types, options=options, target_opset=opset)
    return _tree_graph(converted, width, logistic=False)


@to_onnx.register
def _(fitted: Boosted) -> bytes:
    import onnxmltools
    from onnxmltools.convert.common.data_types import FloatTensorType

    width, opset = fitted.booster.num_feature(), 15  # the highest it knows; only the attributes of the trees are kept
    types = [("rows", FloatTensorType([None, width]))]
    converted = onnxmltools.convert_lightgbm(fitted.booster, initial_types=types, zipmap=False, target_opset=opset)
    return _tree_graph(converted, width, logistic=True)


@to_onnx.register
def _(fitted: SupportVectors) -> bytes:
    """Write the decision value in double: ONNX' own SVM computes in float32 and misses the parity of 1e-6."""
    vectors, norms = np.ascontiguousarray(fitted.vectors.T), np.sum(fitted.vectors**2, axis=1)
    constants: dict[str, Any] = {"mean": fitted.mean, "scale": fitted.scale, "vectors": vectors, "norms": norms}
    constants |= {"weights": fitted.weights, "minus_two": -2.0, "minus_gamma": -fitted.gamma}
    constants |= {"intercept": fitted.intercept, "a": fitted.a, "b": fitted.b}
    node = helper.make_node
    nodes = [
        node("Cast", ["rows"], ["double"], to=TensorProto.DOUBLE),
        node("Sub", ["double", "mean"], ["centred"]),
        node("Div", ["centred", "scale"], ["x"]),
        node("Mul", ["x", "x"], ["xx"]),
        node("ReduceSum", ["xx", "columns"], ["row_norms"], keepdims=1),
        node("MatMul", ["x", "vectors"], ["product"]),
        node("Mul", ["product", "minus_two"], ["cross"]),
        node("Add", ["row_norms", "norms"], ["both_norms"]),
        node("Add", ["both_norms", "cross"], ["squared"]),
        node("Mul", ["squared", "minus_gamma"], ["exponent"]),
        node("Exp", ["exponent"], ["kernel"]),
        node("MatMul", ["kernel", "weights"], ["sum"]),
        node("Add", ["sum", "intercept"], ["decision"]),
        node("Mul", ["decision", "a"], ["slope"]),
        node("Add", ["slope", "b"], ["logit"]),
        node("Sigmoid", ["logit"], ["double_probability"]),
        node("Cast", ["double_probability"], ["probability"], to=TensorProto.FLOAT),
    ]
    initializers = [numpy_helper.from_array(np.asarray(v, np.float64), name) for name, v in constants.items()]
    initializers.append(numpy_helper.from_array(np.array([1], np.int64), "columns"))
    return _serialise(nodes, initializers, len(fitted.mean))


def _tree_graph(converted: onnx.ModelProto, width: int, *, logistic: bool) -> bytes:
    """Rebuild a classifier as the sum of its trees, without marks of missing values, which slow the runtime down."""
    (node,) = [node for node in converted.graph.node if node.op_type == "TreeEnsembleClassifier"]
    found = {item.name: helper.get_attribute_value(item) for item in node.attribute}
    # Converters of scikit-learn give a weight to both classes, that of LightGBM gives the logit as class 0.
    kept = np.flatnonzero(np.array(found["class_ids"]) == max(found["class_ids"]))
    dropped = ("nodes_missing_value_tracks_true", "nodes_hitrates")
    nodes = {key: value for key, value in found.items() if key.startswith("nodes_") and key not in dropped}
    keys = ("nodeids", "treeids", "weights")
    targets: dict[str, Any] = {f"target_{key}": [found[f"class_{key}"][i] for i in kept] for key in keys}
    targets |= {"target_ids": [0] * len(kept), "n_targets": 1}
    how = {"domain": "ai.onnx.ml", "aggregate_function": "SUM", "post_transform": "NONE"}
    trees = helper.make_node("TreeEnsembleRegressor", ["rows"], ["sum"], **how, **targets, **nodes)
    flat = helper.make_node("Reshape", ["sum", "flat"], ["logit" if logistic else "probability"])
    graph = [trees, flat] + ([helper.make_node("Sigmoid", ["logit"], ["probability"])] if logistic else [])
    return _serialise(graph, [numpy_helper.from_array(np.array([-1], np.int64), "flat")], width)


def _serialise(nodes: list[onnx.NodeProto], initializers: list[onnx.TensorProto], width: int) -> bytes:
    """Make a model that holds nothing that could change from run to run."""
    for node in nodes:
        node.name = node.output[0]
    graph = helper.make_graph(
        nodes,
        "epiprior",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, width])],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, [None])],
        initializers,
    )
    opsets = [helper.make_opsetid("", _OPSET), helper.make_opsetid("ai.onnx.ml", _ML_OPSET)]
    model = helper.make_model(graph, producer_name="epiprior", ir_version=_IR_VERSION, opset_imports=opsets)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))
