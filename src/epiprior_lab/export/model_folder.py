"""Model folders: what `epiprior.ranking.models.load_model` reads, made from the results of training and checked."""

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
from epiprior.ranking.models import CARD, MANIFEST, SCHEMA_VERSION, TARGETS, Classifier, load_model
from epiprior_lab.export.model_card import model_card

PARITY = 1e-6
LIBRARIES = ("epiprior", "numpy", "scikit-learn", "lightgbm", "onnx", "skl2onnx", "onnxmltools", "onnxruntime")


class ExportError(EpipriorError, RuntimeError):
    """An exported model gives other probabilities than the fitted one."""


def export_model(training: Path, folder: Path, preset: str) -> None:
    """Make the model folder of a preset from what `training.tables.write_training` wrote, and check it.

    The folder, made if absent, has the model's name; two ONNX files, the manifest and the model card are replaced.
    ExportError if the library, loading it, gives other probabilities than the classifiers that were fitted.
    """
    summary = json.loads((training / "summary.json").read_text(encoding="utf-8"))
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": folder.name,
        "preset": preset,
        "feature_parameters": asdict(find_preset(preset)),
        "training_data": summary["training_data"],
        "library_versions": {library: version(library) for library in LIBRARIES},
    }
    targets = [target for target in TARGETS if target in summary]
    for target in targets:
        item = summary[target]
        manifest[target] = {"family": item["family"], "features": item["columns"], "metrics": item["metrics"]}
        manifest[target]["calibration"] = {"a": item["a"], "b": item["b"]}
    contents = {f"{target}.onnx": (training / f"{target}.onnx").read_bytes() for target in targets}
    contents[CARD] = model_card(manifest).encode()
    manifest["files"] = {file: hashlib.sha256(content).hexdigest() for file, content in contents.items()}
    contents[MANIFEST] = (json.dumps(manifest, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (folder / file).write_bytes(content)
    model = load_model(folder)
    check_parity(training, folder, {target: getattr(model, target) for target in targets})


def check_parity(training: Path, folder: Path, classifiers: Mapping[str, Classifier]) -> None:
    """Raise ExportError where a classifier, loaded from `folder`, differs from the one that was fitted."""
    with np.load(training / "parity.npz", allow_pickle=False) as stored:
        for target, classifier in classifiers.items():
            exported = classifier.uncalibrated(stored[f"{target}_rows"])
            difference = np.max(np.abs(exported - stored[f"{target}_probability"]), initial=0.0)
            if not difference <= PARITY:
                raise ExportError(f"{folder / target}.onnx: differs from the fitted classifier by {difference:.2g}")
