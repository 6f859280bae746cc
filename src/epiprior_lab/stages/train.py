"""Stage `train`: compare the families of classifiers for both targets, and refit the one that is exported."""

from dataclasses import asdict
from pathlib import Path

from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.params import load_study
from epiprior_lab.tracking import track
from epiprior_lab.training.comparison import train
from epiprior_lab.training.tables import seconds_csv, write_training
from epiprior_lab.training.tracked_runs import tracked_runs


def main() -> None:
    """Write ``data/training/<preset>/`` and ``data/timings/train-<preset>.csv`` for every preset."""
    params = load_study()
    folders: dict[str, Path] = {preset: Path("data/features") / preset for preset in params.features.presets}
    trained = train(folders, params.train, workers=default_workers(), store=Path("data/.tasks/train"))
    timings = Path("data/timings")
    timings.mkdir(parents=True, exist_ok=True)
    for preset, comparisons in trained.items():
        write_training(Path("data/training") / preset, comparisons)
        (timings / f"train-{preset}.csv").write_text(seconds_csv(comparisons), encoding="utf-8")
    settings = {key: str(value) for key, value in asdict(params.train).items() if key != "exported"}
    track([run for each in trained.values() for comparison in each for run in tracked_runs(comparison, settings)])


if __name__ == "__main__":
    main()
