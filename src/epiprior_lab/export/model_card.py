"""The README of a model folder: what the model is, what it was trained on, how good it is, its limits."""

from collections.abc import Mapping
from typing import Any

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
