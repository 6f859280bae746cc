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

PARITY = 1e-6
LIBRARIES = ("epiprior", "numpy", "scikit-learn", "lightgbm", "onnx", "skl2onnx", "onnxmltools", "onnxruntime")
_FAMILY_WORDS = {
    "tree": "a decision tree like C4.5: splits by entropy, Laplace-smoothed leaves",
    "random-forest": "a random forest",
    "lightgbm": "gradient-boosted trees of LightGBM",
}
_TARGET_WORDS = {
    "two_keypoint": "a match of 2keypoints (pairs of close features) consists of right matches",
    "match": "a match of two features is right",
    "second_round": "it is, judged again: one of the most probable, with what the first probabilities tell",
}
_METRIC_WORDS = {
    "precision_top_100": "precision of the top 100 per pair",
    "average_precision": "average precision per pair",
    "accuracy": "accuracy at 0.5",
    "precision": "precision at 0.5",
    "log_loss": "log loss",
    "brier_score": "Brier score",
    "expected_calibration_error": "expected calibration error",
}
_MEASURES = ("mean", "deviation", "calibrated", "ungrouped")

_CARD = """\
# epiprior model `{name}`

Classifiers that give putative matches of two photographs their probability of being right. epiprior
loads them for the preset `{preset}`. Anything that runs ONNX can: each takes `rows`, float32 (N, C), and
gives `probability`, float32 (N,), not calibrated yet. Calibrated is `sigmoid(a * logit(probability) + b)`.

| file | gives the probability that | is | columns | a | b |
|---|---|---|---|---|---|
{files}

## Training data

Pairs of {data[scenes]} rendered scenes, {data[rankings]} with their roll hypotheses; labels from depth and
visibility. Of every pair a random sample of rows:
{samples}. The sha256 of all rows and labels is
`{data[sha256]}`.

## Measures

Cross-validation grouped by scene: no scene is in training and test at once. The second classifier was trained
and tested on votes of a first one that never saw the scene, so was any third. A pair counts once per roll
hypothesis. `mean` is over all rows or pairs, `deviation` over the folds, `calibrated` after Platt scaling fitted
on other folds. `ungrouped` deals rows out to folds one by one, as the paper does: what it gains over `mean` is leakage.

{tables}

## Columns, in order

{columns}

## Limits

- The columns must be computed by epiprior with the parameters of the preset `{preset}`, which the manifest
  lists. Other features need another model.
- Probabilities are calibrated on rendered pairs. On photographs, those of hard pairs may be too high: wrong
  rough matrices support the matches that they were made from.
- Scenes are rigid and lenses without distortion. Moving things and mirrors are not in the training data.

## Versions

{versions}
"""


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


def model_card(manifest: Mapping[str, Any]) -> str:
    """Return the card, Markdown, of a manifest, which may still lack the hashes of the files."""
    targets = [target for target in _TARGET_WORDS if target in manifest]
    data = manifest["training_data"]
    return _CARD.format(
        samples="; ".join(f"`{t}` {data[t + '_rows']}, {data[t + '_right']} of them right" for t in targets),
        name=manifest["name"],
        preset=manifest["preset"],
        data=data,
        files="\n".join(_file_row(target, manifest[target]) for target in targets),
        tables="\n\n".join(_table(target, manifest[target]["metrics"]) for target in targets),
        columns="\n".join(f"- `{target}`: {', '.join(manifest[target]['features'])}" for target in targets),
        versions=", ".join(f"{library} {number}" for library, number in manifest["library_versions"].items()),
    )


def _file_row(target: str, item: Mapping[str, Any]) -> str:
    family, scaling = _FAMILY_WORDS[item["family"]], item["calibration"]
    numbers = f"{len(item['features'])} | {scaling['a']:.4f} | {scaling['b']:.4f}"
    return f"| `{target}.onnx` | {_TARGET_WORDS[target]} | {family} | {numbers} |"


def _table(target: str, metrics: Mapping[str, Any]) -> str:
    """Return the table of one classifier; a measure that is not defined shows as a dash."""
    lines = [f"`{target}`", "", f"| measure | {' | '.join(_MEASURES)} |", "|---|---|---|---|---|"]
    for name, words in _METRIC_WORDS.items():
        values = (metrics.get(name, {}).get(key) for key in _MEASURES)
        lines.append(f"| {words} | {' | '.join('-' if v is None else f'{v:.4f}' for v in values)} |")
    return "\n".join(lines)


def write_folder(
    training: Path,
    folder: Path,
    targets: Iterable[str],
    entries: Mapping[str, Any],
    card: Callable[[Mapping[str, Any]], str],
) -> Mapping[str, Any]:
    """Write the classifiers of `targets`, a card, and the manifest, which holds `entries` too; return the manifest."""
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
