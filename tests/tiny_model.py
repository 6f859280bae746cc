"""A model folder made by hand: two logistic regressions, for tests that must not wait for training."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from epiprior.presets import DEFAULT

TWO_KEYPOINT_WEIGHTS = {
    "similarity_main": 4.0,
    "similarity_neighbour": 4.0,
    "scale_change_difference": -2.0,
    "turn_difference": -2.0,
}
MATCH_WEIGHTS = {"similarity": 4.0, "mutual": 3.0, "relative_support": 2.0, "distance_ratio": -4.0}


def logistic(columns: tuple[str, ...], weights: Mapping[str, float], offset: float) -> bytes:
    """An ONNX graph of rows -> sigmoid(rows @ weights + offset); columns without a weight count nothing."""
    column = np.array([[weights.get(name, 0.0)] for name in columns], np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["rows", "weights"], ["product"]),
            helper.make_node("Add", ["product", "offset"], ["logit"]),
            helper.make_node("Sigmoid", ["logit"], ["column"]),
            helper.make_node("Squeeze", ["column", "axes"], ["probability"]),
        ],
        "logistic",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, len(columns)])],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, [None])],
        [
            numpy_helper.from_array(column, "weights"),
            numpy_helper.from_array(np.array([offset], np.float32), "offset"),
            numpy_helper.from_array(np.array([1], np.int64), "axes"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def make_model(folder: Path) -> Path:
    """Write a whole model for the preset ``default`` to a new folder and return it."""
    folder.mkdir()
    files = {
        "two_keypoint.onnx": logistic(DEFAULT.two_keypoint_columns, TWO_KEYPOINT_WEIGHTS, -5.0),
        "match.onnx": logistic(DEFAULT.match_columns, MATCH_WEIGHTS, -1.0),
        "README.md": b"A model made by hand.\n",
    }
    manifest = {
        "schema_version": 1,
        "name": "default",
        "preset": "default",
        "feature_parameters": {"max_keypoints": 4000},
        "training_data": {"sha256": "0" * 64, "pairs": 0},
        "library_versions": {"onnx": onnx.__version__},
        "two_keypoint": {
            "family": "logistic",
            "features": list(DEFAULT.two_keypoint_columns),
            "calibration": {"a": 1.0, "b": 0.0},
            "metrics": {"brier": 0.125},
        },
        "match": {
            "family": "logistic",
            "features": list(DEFAULT.match_columns),
            "calibration": {"a": 1.0, "b": 0.0},
            "metrics": {"brier": 0.0625},
        },
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))
    return folder
