"""The model folder of the confidence: what `epiprior.verification.confidence.load_confidence` reads."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from epiprior.verification.confidence import CONFIDENCE_TARGETS, load_confidence
from epiprior_lab.export.model_folder import check_parity, write_folder
from epiprior_lab.training.cross_validation import ROW_METRICS

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

Estimates on {data[scenes]} blocks of rendered scenes that no ranker saw, {data[rankings]} pairs in all: {counts}.
{rows} rows, {positive} of a right F; half of them lack what matches of others may lack. The sha256 of rows
and labels is `{data[sha256]}`.

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


def export_confidence(
    training: Path, folder: Path, *, least: float, floor: float, accepted: float, counts: dict[str, int]
) -> None:
    """Make the folder from what `training.tables.write_training` wrote, and check it through the library.

    `least` is the default of the confidence that is asked for, `accepted` the share of unrelated estimates for which it
    was chosen, `counts` the pairs of each kind. ExportError if the library gives other probabilities.
    """

    def card(manifest: Mapping[str, Any]) -> str:
        data, items = manifest["training_data"], [manifest[target] for target in CONFIDENCE_TARGETS]
        right, flat = (f"{i['family']} | {i['calibration']['a']:.4f} | {i['calibration']['b']:.4f}" for i in items)
        measured = [(name, *(f"{item['metrics'][name]['calibrated']:.4f}" for item in items)) for name in ROW_METRICS]
        values = {"right": right, "flat": flat, "least": least, "floor": floor, "accepted": accepted, "data": data}
        values |= {"rows": data["confidence_rows"], "positive": data["confidence_right"]}
        return _CARD.format(
            **values,
            columns="\n".join(f"- `{t}`: {', '.join(manifest[t]['features'])}" for t in CONFIDENCE_TARGETS),
            counts=", ".join(f"{count} {kind}" for kind, count in counts.items()),
            measures="\n".join(f"| {' | '.join(row)} |" for row in measured),
            versions=", ".join(f"{library} {number}" for library, number in manifest["library_versions"].items()),
        )

    entries = {"min_confidence": least, "training_data": {"pairs": counts}}
    write_folder(training, folder, CONFIDENCE_TARGETS, entries, card)
    load_confidence.cache_clear()
    model = load_confidence(folder)
    check_parity(training, folder, {"confidence": model.confidence, "homography": model.homography})
