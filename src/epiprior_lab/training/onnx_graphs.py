"""Fitted classifiers as ONNX graphs, the same bytes in every run: ``rows`` (N, C), ``probability`` (N,), float32."""

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from epiprior_lab.training.families import Boosted, Trees

_OPSET, _ML_OPSET, _IR_VERSION = 17, 3, 9
_LIGHTGBM_OPSET = 15  # the highest that its converter knows; only the attributes of the trees are kept


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
