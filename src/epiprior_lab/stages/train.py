"""Stage `train`: compare the families of classifiers for both targets, and refit the one that is exported."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.params import TrainParams, load_study
from epiprior_lab.tracking import TrackedFamily, track
from epiprior_lab.training.classifiers import Comparison
from epiprior_lab.training.model_training import PresetTraining, train_preset
from epiprior_lab.training.training_tables import seconds_csv, write_training


def main() -> None:
    """Write ``data/training/<preset>/`` and ``data/timings/train-<preset>.csv`` for every preset."""
    params = load_study()
    for preset in params.features.presets:
        _train(preset, params.train)


def _train(preset: str, params: TrainParams) -> None:
    trained = train_preset(
        Path("data/features") / preset,
        preset,
        params,
        workers=default_workers(),
        store=Path("data/.tasks/train") / preset,
    )
    write_training(Path("data/training") / preset, trained)
    timings = Path("data/timings") / f"train-{preset}.csv"
    timings.parent.mkdir(parents=True, exist_ok=True)
    timings.write_text(seconds_csv(trained.comparisons), encoding="utf-8")
    settings = {key: str(value) for key, value in asdict(params).items() if key != "exported"}
    for comparison in trained.comparisons:
        track(_tracked(comparison, trained, preset, settings))


def _tracked(
    comparison: Comparison, trained: PresetTraining, preset: str, settings: dict[str, str]
) -> list[TrackedFamily]:
    data = comparison.data
    described = {**settings, "rows": len(data.rows), "pairs": len(data.share), "data_sha256": data.digest()}
    return [
        TrackedFamily(
            target=data.target,
            preset=preset,
            exported=family == trained.family,
            grouped=grouped,
            ungrouped=comparison.ungrouped.get(family),
            labels=data.labels,
            importances=comparison.refits[family].importances,
            onnx=comparison.refits[family].onnx,
            example=data.rows,
            parameters=described,
        )
        for family, grouped in comparison.grouped.items()
    ]


if __name__ == "__main__":
    main()
