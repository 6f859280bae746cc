"""Exported models: classifiers as ONNX, and a manifest that says what they were trained on.

A model is a folder: ``two_keypoint.onnx`` gives the probability of 2keypoint matches (paper, section 4.4),
``match.onnx`` that of matches (section 4.6), ``second_round.onnx``, where there is one, that of the most
probable of these, judged again. ``manifest.json`` describes them, ``README.md`` is the model card. Loading executes
nothing of the folder; a folder that differs from its manifest is refused.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from epiprior.errors import FeatureError, ModelError
from epiprior.settings_file import find_settings_file
from epiprior.types import Float32Array, FloatArray

SCHEMA_VERSION = 1
TARGETS = ("two_keypoint", "match", "second_round")
OPTIONAL = ("second_round",)
CARD = "README.md"
MANIFEST = "manifest.json"

# Raw probabilities are kept so far from 0 and 1 that their logit is finite in float32.
_CLIP = 1e-7
# Rows per call of the runtime: small enough for the cache, and for the kernel matrix of an SVM.
_CHUNK = 8192


def calibrate(probability: FloatArray, a: float, b: float) -> FloatArray:
    """Return ``sigmoid(a * logit(p) + b)``, in (0, 1): Platt scaling, strictly increasing for ``a > 0``.

    Probabilities are those of the classifier, in [0, 1]; they are clipped to [1e-7, 1 - 1e-7].
    """
    p = np.clip(np.asarray(probability, np.float64), _CLIP, 1.0 - _CLIP)
    return np.asarray(1.0 / (1.0 + np.exp(-(a * (np.log(p) - np.log1p(-p)) + b))), np.float64)


@dataclass(frozen=True)
class Classifier:
    """One exported classifier with its calibration.

    The session runs in one thread, so that sums are taken in one order: the bytes do not depend on the machine's load.
    """

    session: onnxruntime.InferenceSession  # takes rows (N, C) float32, gives probability (N,)
    columns: tuple[str, ...]  # names of the C columns, in order
    a: float  # Platt scaling of the logit: a logit + b
    b: float

    def __call__(self, rows: Float32Array) -> FloatArray:
        """Return calibrated probabilities, in (0, 1)."""
        return calibrate(self.uncalibrated(rows), self.a, self.b)

    def uncalibrated(self, rows: Float32Array) -> FloatArray:
        """Return the probabilities as the classifier gives them.

        FeatureError if the rows have another shape or type, or hold a value that is not finite.
        """
        if not isinstance(rows, np.ndarray) or rows.dtype != np.float32:
            got = rows.dtype if isinstance(rows, np.ndarray) else type(rows).__name__
            raise FeatureError(f"rows to classify: expected a float32 array, got {got}")
        if rows.ndim != 2 or rows.shape[1] != len(self.columns):
            raise FeatureError(
                f"rows to classify have shape {rows.shape}, expected (N, {len(self.columns)}): "
                f"{', '.join(self.columns)}"
            )
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise FeatureError(f"rows to classify: {self.columns[column]} of row {row} is {rows[row, column]}")
        parts = [np.empty(0)]
        for first in range(0, len(rows), _CHUNK):
            chunk = np.ascontiguousarray(rows[first : first + _CHUNK])
            parts.append(np.asarray(self.session.run(["probability"], {"rows": chunk})[0], np.float64).reshape(-1))
        return np.concatenate(parts)


@dataclass(frozen=True)
class RankingModel:
    """The classifiers of a preset: of 2keypoint matches, of matches, and of matches in a second round, if any."""

    name: str
    manifest: Mapping[str, Any]  # contents of manifest.json: preset, training data, metrics, library versions, hashes
    two_keypoint: Classifier  # of columns of 2kpmd (section 4.4)
    match: Classifier  # of columns of kpmd (section 4.6)
    second_round: Classifier | None = None


def find_model(name: str) -> Path:
    """Return the folder of a model that comes with epiprior; ModelError if there is none of that name."""
    found = find_settings_file(name) if name else None
    if found is None or not found.is_dir():
        raise ModelError(f"no model named {name!r} comes with epiprior")
    return found


def load_model(name_or_path: str | Path) -> RankingModel:
    """Load a model, and check that it is whole.

    `name_or_path` is a name for `find_model`, or a folder: a `Path`, or a string with a slash in it.

    Raises
    ------
    ModelError : If the folder or a file is missing, a file's hash is not the manifest's, the manifest is not JSON,
        misses something or has an unknown schema, or its feature names do not fit the classifier; it names the file.
    """
    is_name = isinstance(name_or_path, str) and not any(slash in name_or_path for slash in "/\\")
    folder = find_model(str(name_or_path)) if is_name else Path(name_or_path)
    manifest, classifiers = read_classifiers(folder, TARGETS)
    return RankingModel(_entry(manifest, folder / MANIFEST, str, "name"), manifest, *classifiers)


def read_classifiers(folder: Path, targets: Sequence[str]) -> tuple[dict[str, Any], list[Classifier]]:
    """Return the manifest of a folder and its classifiers, in the order of `targets`; raises as `load_model`.

    A target of `OPTIONAL` that the manifest does not name is left out.
    """
    if not folder.is_dir():
        raise ModelError(f"{folder}: no such folder")
    path = folder / MANIFEST
    content = _read(path)
    try:
        manifest = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not JSON: {error}") from error
    version = manifest.get("schema_version") if isinstance(manifest, dict) else None
    if version != SCHEMA_VERSION:
        raise ModelError(f"{path}: schema_version is {version!r}, this epiprior reads {SCHEMA_VERSION}")
    targets = [target for target in targets if target not in OPTIONAL or target in manifest]
    contents = {}
    for file in (*(f"{target}.onnx" for target in targets), CARD):
        expected = _entry(manifest, path, str, "files", file)
        contents[file] = _read(folder / file)
        found = hashlib.sha256(contents[file]).hexdigest()
        if found != expected:
            raise ModelError(f"{folder / file}: sha256 is {found}, {MANIFEST} says {expected}")
    return manifest, [_classifier(path, manifest, target, contents[f"{target}.onnx"]) for target in targets]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error


def _entry(manifest: Any, path: Path, kind: type, *keys: str) -> Any:
    """Return the entry of the manifest under nested `keys`; ModelError unless it is of the type `kind`."""
    value = manifest
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    if not isinstance(value, kind):
        raise ModelError(f"{path}: {' / '.join(keys)} is {value!r}, expected {kind.__name__}")
    return value


def _classifier(path: Path, manifest: dict[str, Any], target: str, content: bytes) -> Classifier:
    """Open one classifier and compare it with the manifest, read from `path`."""
    columns = _entry(manifest, path, list, target, "features")
    if not columns or len(set(map(str, columns))) != len(columns) or not all(isinstance(c, str) for c in columns):
        raise ModelError(f"{path}: {target}.features is {columns!r}, expected different names")
    a, b = (_entry(manifest, path, float, target, "calibration", key) for key in "ab")
    if not (np.isfinite(a) and np.isfinite(b) and a > 0):
        raise ModelError(f"{path}: {target}.calibration is a = {a}, b = {b}, expected finite and a > 0")
    file = path.with_name(f"{target}.onnx")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ModelError(f"{file}: onnxruntime cannot load it: {error}") from error
    inputs = [(item.name, item.type, len(item.shape)) for item in session.get_inputs()]
    outputs = [item.name for item in session.get_outputs()]
    if inputs != [("rows", "tensor(float)", 2)] or outputs != ["probability"]:
        raise ModelError(f"{file}: takes {inputs} and gives {outputs}, expected float 'rows' and 'probability'")
    width = session.get_inputs()[0].shape[1]
    if width != len(columns):
        raise ModelError(f"{file}: takes {width} columns, {MANIFEST} names {len(columns)}: {', '.join(columns)}")
    return Classifier(session, tuple(columns), a, b)
