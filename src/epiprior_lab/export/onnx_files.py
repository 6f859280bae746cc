"""Model files: any fitted classifier as ONNX, and the folder that `epiprior.ranking.models.load_model` reads.

Every graph is ``rows`` (N, C) float32 in, ``probability`` (N,) float32 out, and the same fit gives the same
bytes.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from epiprior.errors import EpipriorError
from epiprior.presets import find_preset
from epiprior.ranking.models import CARD, MANIFEST, SCHEMA_VERSION, TARGETS, load_model
from epiprior_lab.export.model_card import model_card
from epiprior_lab.training.families import Boosted, Fitted, SupportVectors, Trees

_OPSET, _ML_OPSET, _IR_VERSION = 17, 3, 9
PARITY = 1e-6
_LIBRARIES = (
    "epiprior",
    "numpy",
    "scikit-learn",
    "lightgbm",
    "onnx",
    "skl2onnx",
    "onnxmltools",
    "onnxruntime",
)


class ExportError(EpipriorError, RuntimeError):
    """An exported model does not say what the fitted one says."""


@dataclass(frozen=True, kw_only=True)
class ExportedClassifier:
    """One classifier of a model folder.

    Parameters
    ----------
    onnx : bytes
        The graph.
    family : str
        Name in `families.FAMILIES`.
    columns : tuple of str
        Ordered feature names.
    a, b : float
        Platt scaling of the logit.
    metrics : mapping
        Measures to put into manifest and model card.
    """

    onnx: bytes
    family: str
    columns: tuple[str, ...]
    a: float
    b: float
    metrics: Mapping[str, Any]


@functools.singledispatch
def to_onnx(fitted: Fitted) -> bytes:
    """Return a fitted classifier as a serialised ONNX graph.

    Parameters
    ----------
    fitted : Fitted
        Of any family.

    Returns
    -------
    bytes
        Its probabilities equal ``fitted.probability`` to 1e-6 on any finite float32 rows.

    Raises
    ------
    TypeError
        If the class is not one of `families`.
    """
    raise TypeError(f"no ONNX export for {type(fitted).__name__}")


@to_onnx.register
def _(fitted: Trees) -> bytes:
    import skl2onnx
    from skl2onnx.common.data_types import FloatTensorType

    converted = skl2onnx.convert_sklearn(
        fitted.estimator,
        initial_types=[("rows", FloatTensorType([None, fitted.width]))],
        options={"zipmap": False},
        target_opset={"": _OPSET, "ai.onnx.ml": _ML_OPSET},
    )
    return _tree_graph(converted, fitted.width, logistic=False)


@to_onnx.register
def _(fitted: Boosted) -> bytes:
    import onnxmltools
    from onnxmltools.convert.common.data_types import FloatTensorType

    converted = onnxmltools.convert_lightgbm(
        fitted.booster,
        initial_types=[("rows", FloatTensorType([None, fitted.width]))],
        zipmap=False,
        target_opset=15,  # the highest that onnxmltools knows; only the attributes of the trees are kept
    )
    return _tree_graph(converted, fitted.width, logistic=True)


@to_onnx.register
def _(fitted: SupportVectors) -> bytes:
    """Write the decision value in double: ONNX' own SVM computes in float32 and misses the parity of 1e-6."""
    scaled = fitted.vectors
    constants = {
        "mean": fitted.mean,
        "scale": fitted.scale,
        "vectors": np.ascontiguousarray(scaled.T),
        "norms": np.sum(scaled**2, axis=1),
        "weights": fitted.weights,
        "minus_two": np.array(-2.0),
        "minus_gamma": np.array(-fitted.gamma),
        "intercept": np.array(fitted.intercept),
        "a": np.array(fitted.a),
        "b": np.array(fitted.b),
    }
    nodes = [
        helper.make_node("Cast", ["rows"], ["double"], to=TensorProto.DOUBLE),
        helper.make_node("Sub", ["double", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "scale"], ["x"]),
        helper.make_node("Mul", ["x", "x"], ["xx"]),
        helper.make_node("ReduceSum", ["xx", "columns"], ["row_norms"], keepdims=1),
        helper.make_node("MatMul", ["x", "vectors"], ["product"]),
        helper.make_node("Mul", ["product", "minus_two"], ["cross"]),
        helper.make_node("Add", ["row_norms", "norms"], ["both_norms"]),
        helper.make_node("Add", ["both_norms", "cross"], ["squared"]),
        helper.make_node("Mul", ["squared", "minus_gamma"], ["exponent"]),
        helper.make_node("Exp", ["exponent"], ["kernel"]),
        helper.make_node("MatMul", ["kernel", "weights"], ["sum"]),
        helper.make_node("Add", ["sum", "intercept"], ["decision"]),
        helper.make_node("Mul", ["decision", "a"], ["slope"]),
        helper.make_node("Add", ["slope", "b"], ["logit"]),
        helper.make_node("Sigmoid", ["logit"], ["double_probability"]),
        helper.make_node("Cast", ["double_probability"], ["probability"], to=TensorProto.FLOAT),
    ]
    initializers = [numpy_helper.from_array(np.asarray(v, np.float64), name) for name, v in constants.items()]
    initializers.append(numpy_helper.from_array(np.array([1], np.int64), "columns"))
    return _serialise(nodes, initializers, fitted.width)


def _tree_graph(converted: onnx.ModelProto, width: int, *, logistic: bool) -> bytes:
    """Rebuild a converted classifier as the sum of its trees.

    What converters put around the trees is dropped: labels, and the marks of where missing values go, which
    slow the runtime down and mean nothing for finite rows.
    """
    (node,) = [node for node in converted.graph.node if node.op_type == "TreeEnsembleClassifier"]
    found = {item.name: helper.get_attribute_value(item) for item in node.attribute}
    # Converters of scikit-learn give a weight to both classes, that of LightGBM gives the logit as class 0.
    kept = np.flatnonzero(np.array(found["class_ids"]) == max(found["class_ids"]))
    nodes = {key: value for key, value in found.items() if key.startswith("nodes_")}
    nodes.pop("nodes_missing_value_tracks_true", None)
    nodes.pop("nodes_hitrates", None)
    trees = helper.make_node(
        "TreeEnsembleRegressor",
        ["rows"],
        ["sum"],
        domain="ai.onnx.ml",
        n_targets=1,
        aggregate_function="SUM",
        post_transform="NONE",
        target_ids=[0] * len(kept),
        target_nodeids=[found["class_nodeids"][i] for i in kept],
        target_treeids=[found["class_treeids"][i] for i in kept],
        target_weights=[found["class_weights"][i] for i in kept],
        **nodes,
    )
    flat = helper.make_node("Reshape", ["sum", "flat"], ["logit" if logistic else "probability"])
    graph = [trees, flat] + ([helper.make_node("Sigmoid", ["logit"], ["probability"])] if logistic else [])
    return _serialise(graph, [numpy_helper.from_array(np.array([-1], np.int64), "flat")], width)


def _serialise(nodes: list[onnx.NodeProto], initializers: list[onnx.TensorProto], width: int) -> bytes:
    """Make a model with nothing in it that could change from run to run."""
    for node in nodes:
        node.name = node.output[0]
    graph = helper.make_graph(
        nodes,
        "epiprior",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, width])],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, [None])],
        initializers,
    )
    model = helper.make_model(
        graph,
        producer_name="epiprior",
        ir_version=_IR_VERSION,
        opset_imports=[helper.make_opsetid("", _OPSET), helper.make_opsetid("ai.onnx.ml", _ML_OPSET)],
    )
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))


def write_model(
    folder: Path,
    *,
    name: str,
    preset: str,
    classifiers: Mapping[str, ExportedClassifier],
    feature_parameters: Mapping[str, Any],
    training_data: Mapping[str, Any],
) -> None:
    """Write a model folder: two ONNX files, the manifest and the model card.

    Parameters
    ----------
    folder : Path
        Made if absent; files of these names are replaced.
    name, preset : str
        Of the model, and of the preset whose features it takes.
    classifiers : mapping
        For each of `epiprior.ranking.models.TARGETS`.
    feature_parameters : mapping
        Parameters of the features that it was trained on.
    training_data : mapping
        ``sha256`` of the rows, and counts of pairs, scenes and rows.
    """
    versions = {library: version(library) for library in _LIBRARIES}
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": name,
        "preset": preset,
        "feature_parameters": dict(feature_parameters),
        "training_data": dict(training_data),
        "library_versions": versions,
    }
    contents = {f"{target}.onnx": classifiers[target].onnx for target in TARGETS}
    for target in TARGETS:
        item = classifiers[target]
        manifest[target] = {
            "family": item.family,
            "features": list(item.columns),
            "calibration": {"a": float(item.a), "b": float(item.b)},
            "metrics": dict(item.metrics),
        }
    contents[CARD] = model_card(manifest).encode()
    manifest["files"] = {file: hashlib.sha256(content).hexdigest() for file, content in contents.items()}
    contents[MANIFEST] = (json.dumps(manifest, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (folder / file).write_bytes(content)


def export_model(training: Path, folder: Path, preset: str) -> None:
    """Make the model folder of a preset from the results of its training, and check it.

    Parameters
    ----------
    training : Path
        Folder that `training_tables.write_training` wrote.
    folder : Path
        The model's folder; its name is the model's.
    preset : str
        Whose features the model takes.

    Raises
    ------
    ExportError
        If the library, loading the folder, gives other probabilities than the classifiers that were fitted.
    """
    summary = json.loads((training / "summary.json").read_text(encoding="utf-8"))
    write_model(
        folder,
        name=folder.name,
        preset=preset,
        classifiers={
            target: ExportedClassifier(
                onnx=(training / f"{target}.onnx").read_bytes(),
                family=summary[target]["family"],
                columns=tuple(summary[target]["columns"]),
                a=summary[target]["a"],
                b=summary[target]["b"],
                metrics=summary[target]["metrics"],
            )
            for target in TARGETS
        },
        feature_parameters=asdict(find_preset(preset)),
        training_data=summary["training_data"],
    )
    model = load_model(folder)
    with np.load(training / "parity.npz", allow_pickle=False) as stored:
        for target, classifier in ((TARGETS[0], model.two_keypoint), (TARGETS[1], model.match)):
            exported = classifier.uncalibrated(stored[f"{target}_rows"])
            difference = np.max(np.abs(exported - stored[f"{target}_probability"]), initial=0.0)
            if not difference <= PARITY:
                raise ExportError(f"{folder / target}.onnx: differs from the fitted classifier by {difference:.2g}")
