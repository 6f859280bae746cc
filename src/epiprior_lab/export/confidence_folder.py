"""The model folder of the confidence: what `epiprior.verification.confidence.load_confidence` reads."""

import hashlib
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

from epiprior.ranking.models import CARD, MANIFEST, SCHEMA_VERSION
from epiprior.verification.confidence import CONFIDENCE_TARGETS, load_confidence
from epiprior_lab.export.model_folder import LIBRARIES, check_parity

_CARD = """\
# epiprior model `confidence`

Two classifiers over the facts of an estimate (`epiprior.verification.facts`), one for all estimators and all inputs.
Each takes `rows`, float32 (N, C), and gives `probability`, float32 (N,), not calibrated yet. Calibrated is
`sigmoid(a * logit(probability) + b)`.

| file | gives the probability that | family | a | b |
|---|---|---|---|---|
| `confidence.onnx` | F is right: its mean error over the whole overlap is below 10 px at working size | {right} |
| `homography.onnx` | a homography relates the images (plane, turning camera, copy): F is undecided | {flat} |

An F is relied on from a confidence of {least:.3f} on: at most {accepted:.1%} of the estimates on unrelated pairs
reach it, cross-validated, and never below {floor}.

## Training data

Estimates on {scenes} blocks of rendered scenes that no ranker saw, {rankings} pairs in all: {counts}.
{rows} rows, {positive} of a right F; half of them lack what matches of others may lack. The sha256 of rows
and labels is `{sha256}`.

## Measures

Cross-validation by blocks of scenes, calibrated on the other folds.

| measure | confidence | homography |
|---|---|---|
{measures}

## Columns, in order

{columns}

## Limits

- Probabilities are calibrated on rendered pairs; the report on photographs shows how they do there.
- Photographs of different places in one style (`doppelganger`) are few in the training data.
- Moving things and mirrors are not in the training data.

## Versions

{versions}
"""
_MEASURES = ("accuracy", "precision", "log_loss", "brier_score", "expected_calibration_error")


def export_confidence(
    training: Path, folder: Path, *, least: float, floor: float, accepted: float, counts: dict[str, int]
) -> None:
    """Make the folder from what `training.tables.write_training` wrote, and check it through the library.

    `least` is the default of the confidence that is asked for, `accepted` the share of unrelated estimates for which it
    was chosen, `counts` the pairs of each kind. ExportError if the library gives other probabilities.
    """
    summary = json.loads((training / "summary.json").read_text(encoding="utf-8"))
    data = summary["training_data"] | {"pairs": counts}
    versions = {library: version(library) for library in LIBRARIES}
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": folder.name,
        "training_data": data,
        "library_versions": versions,
        "min_confidence": least,
    }
    rows = {}
    for target in CONFIDENCE_TARGETS:
        item = summary[target]
        manifest[target] = {"family": item["family"], "features": item["columns"], "metrics": item["metrics"]}
        manifest[target]["calibration"] = {"a": item["a"], "b": item["b"]}
        rows[target] = f"{item['family']} | {item['a']:.4f} | {item['b']:.4f}"
    calibrated = [summary[target]["metrics"] for target in CONFIDENCE_TARGETS]
    card = _CARD.format(
        columns="\n".join(f"- `{t}`: {', '.join(summary[t]['columns'])}" for t in CONFIDENCE_TARGETS),
        right=rows["confidence"],
        flat=rows["homography"],
        least=least,
        floor=floor,
        accepted=accepted,
        scenes=data["scenes"],
        rankings=data["rankings"],
        rows=data["confidence_rows"],
        positive=data["confidence_right"],
        sha256=data["sha256"],
        counts=", ".join(f"{count} {kind}" for kind, count in counts.items()),
        measures="\n".join(
            f"| {name} | " + " | ".join(f"{metrics[name]['calibrated']:.4f}" for metrics in calibrated) + " |"
            for name in _MEASURES
        ),
        versions=", ".join(f"{library} {number}" for library, number in versions.items()),
    )
    contents = {f"{target}.onnx": (training / f"{target}.onnx").read_bytes() for target in CONFIDENCE_TARGETS}
    contents[CARD] = card.encode()
    manifest["files"] = {file: hashlib.sha256(content).hexdigest() for file, content in contents.items()}
    contents[MANIFEST] = (json.dumps(manifest, indent=2, sort_keys=True, allow_nan=False) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (folder / file).write_bytes(content)
    load_confidence.cache_clear()
    model = load_confidence(folder)
    check_parity(training, folder, {"confidence": model.confidence, "homography": model.homography})
