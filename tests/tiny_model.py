"""A model folder made by hand: two logistic regressions, for tests that must not wait for training."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from epiprior.presets import DEFAULT

TWO_KEYPOINT_WEIGHTS = dict.fromkeys(("similarity_main", "similarity_neighbour"), 4.0)
TWO_KEYPOINT_WEIGHTS |= dict.fromkeys(("scale_change_difference", "turn_difference"), -2.0)
MATCH_WEIGHTS = {"similarity": 4.0, "mutual": 3.0, "relative_support": 2.0, "distance_ratio": -4.0}


def logistic(columns: tuple[str, ...], weights: Mapping[str, float], offset: float) -> bytes:
    """An ONNX graph of rows -> sigmoid(rows @ weights + offset); columns without a weight count nothing."""
    column = np.array([[weights.get(name, 0.0)] for name in columns], np.float32)
    steps = {"MatMul": "rows weights product", "Add": "product offset logit", "Sigmoid": "logit column"}
    steps["Squeeze"] = "column axes probability"
    values = {"weights": column, "offset": np.array([offset], np.float32), "axes": np.array([1], np.int64)}
    graph = helper.make_graph(
        [helper.make_node(kind, names.split()[:-1], names.split()[-1:]) for kind, names in steps.items()],
        "logistic",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, len(columns)])],
        [helper.make_tensor_value_info("probability", TensorProto.FLOAT, [None])],
        [numpy_helper.from_array(value, name) for name, value in values.items()],
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
    manifest = {"schema_version": 1, "name": "default", "preset": "default"}
    manifest["library_versions"] = {"onnx": onnx.__version__}
    manifest |= {"feature_parameters": {"max_keypoints": 4000}, "training_data": {"sha256": "0" * 64, "pairs": 0}}
    columns = {"two_keypoint": DEFAULT.two_keypoint_columns, "match": DEFAULT.match_columns}
    for (target, names), brier in zip(columns.items(), (0.125, 0.0625), strict=True):
        about = {"calibration": {"a": 1.0, "b": 0.0}, "metrics": {"brier": brier}}
        manifest[target] = {"family": "logistic", "features": list(names)} | about
    manifest["files"] = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))
    return folder
