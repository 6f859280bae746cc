"""Model folders: what `epiprior.ranking.models.load_model` reads, made from the results of training and checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import EpipriorError
from epiprior.presets import find_preset
from epiprior.ranking.models import CARD, MANIFEST, SCHEMA_VERSION, TARGETS, load_model
from epiprior_lab.export.model_card import model_card

PARITY = 1e-6
_LIBRARIES = ("epiprior", "numpy", "scikit-learn", "lightgbm", "onnx", "skl2onnx", "onnxmltools", "onnxruntime")


class ExportError(EpipriorError, RuntimeError):
    """An exported model gives other probabilities than the fitted one."""


def write_model(
    folder: Path, *, preset: str, summary: Mapping[str, Any], graphs: Mapping[str, bytes], parameters: Mapping[str, Any]
) -> None:
    """Write a model folder: two ONNX files, the manifest and the model card.

    Parameters
    ----------
    folder : Path
        Made if absent; its name is the model's. Files of these names are replaced.
    preset : str
        Whose features the model takes.
    summary : mapping
        ``training_data`` (``sha256`` of the rows and counts), and for each of `TARGETS` its ``family``, ``columns``,
        Platt scaling ``a`` and ``b``, and ``metrics``.
    graphs : mapping of str to bytes
        ONNX graph of each target.
    parameters : mapping
        Parameters of the features that it was trained on.
    """
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": folder.name,
        "preset": preset,
        "feature_parameters": dict(parameters),
        "training_data": summary["training_data"],
        "library_versions": {library: version(library) for library in _LIBRARIES},
    }
    for target in TARGETS:
        item = summary[target]
        manifest[target] = {
            "family": item["family"],
            "features": list(item["columns"]),
            "calibration": {"a": item["a"], "b": item["b"]},
            "metrics": item["metrics"],
        }
    contents = {f"{target}.onnx": graphs[target] for target in TARGETS}
    contents[CARD] = model_card(manifest).encode()
    manifest["files"] = {file: hashlib.sha256(content).hexdigest() for file, content in contents.items()}
    contents[MANIFEST] = (json.dumps(manifest, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (folder / file).write_bytes(content)


def export_model(training: Path, folder: Path, preset: str) -> None:
    """Make the model folder of a preset from what `training.tables.write_training` wrote, and check it.

    Raises
    ------
    ExportError
        If the library, loading the folder, gives other probabilities than the classifiers that were fitted.
    """
    summary = json.loads((training / "summary.json").read_text(encoding="utf-8"))
    graphs = {target: (training / f"{target}.onnx").read_bytes() for target in TARGETS}
    write_model(folder, preset=preset, summary=summary, graphs=graphs, parameters=asdict(find_preset(preset)))
    model = load_model(folder)
    with np.load(training / "parity.npz", allow_pickle=False) as stored:
        for target, classifier in zip(TARGETS, (model.two_keypoint, model.match), strict=True):
            exported = classifier.uncalibrated(stored[f"{target}_rows"])
            difference = np.max(np.abs(exported - stored[f"{target}_probability"]), initial=0.0)
            if not difference <= PARITY:
                raise ExportError(f"{folder / target}.onnx: differs from the fitted classifier by {difference:.2g}")
