"""Model folders: what `epiprior.ranking.models.load_model` reads, made from the results of training and checked."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
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
    entries = {"preset": preset, "feature_parameters": asdict(find_preset(preset))}
    manifest = write_folder(training, folder, TARGETS, entries, model_card)
    model = load_model(folder)
    check_parity(training, folder, {target: getattr(model, target) for target in TARGETS if target in manifest})


def write_folder(
    training: Path,
    folder: Path,
    targets: Iterable[str],
    entries: Mapping[str, Any],
    card: Callable[[Mapping[str, Any]], str],
) -> Mapping[str, Any]:
    """Write the classifiers that training made of `targets`, with a manifest and its card; return the manifest.

    It holds `entries` beside what training says.
    """
    summary = json.loads((training / "summary.json").read_text(encoding="utf-8"))
    manifest: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "name": folder.name, **entries}
    manifest["training_data"] = summary["training_data"] | entries.get("training_data", {})
    manifest["library_versions"] = {library: version(library) for library in LIBRARIES}
    contents = {}
    for target in (target for target in targets if target in summary):
        item = summary[target]
        manifest[target] = {"family": item["family"], "features": item["columns"], "metrics": item["metrics"]}
        manifest[target]["calibration"] = {"a": item["a"], "b": item["b"]}
        contents[f"{target}.onnx"] = (training / f"{target}.onnx").read_bytes()
    contents[CARD] = card(manifest).encode()
    manifest["files"] = {file: hashlib.sha256(content).hexdigest() for file, content in contents.items()}
    contents[MANIFEST] = (json.dumps(manifest, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (folder / file).write_bytes(content)
    return manifest


def check_parity(training: Path, folder: Path, classifiers: Mapping[str, Classifier]) -> None:
    """Raise ExportError where a classifier, loaded from `folder`, differs from the one that was fitted."""
    with np.load(training / "parity.npz", allow_pickle=False) as stored:
        for target, classifier in classifiers.items():
            exported = classifier.uncalibrated(stored[f"{target}_rows"])
            difference = np.max(np.abs(exported - stored[f"{target}_probability"]), initial=0.0)
            if not difference <= PARITY:
                raise ExportError(f"{folder / target}.onnx: differs from the fitted classifier by {difference:.2g}")
