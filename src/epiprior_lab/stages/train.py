"""Stage `train`: compare the families of classifiers for all targets, and refit the one that is exported."""

from dataclasses import asdict
from pathlib import Path

from epiprior_lab.params import load_study
from epiprior_lab.tracking import track
from epiprior_lab.training.comparison import train
from epiprior_lab.training.tables import write_training


def main() -> None:
    """Write ``data/training/<preset>/`` for every preset."""
    params = load_study()
    found = []
    for preset in params.features.presets:
        comparisons = train(preset, Path("data/features") / preset, params.train, Path("data/.tasks/train"))
        write_training(Path("data/training") / preset, comparisons)
        found += comparisons
    track(found, {key: str(value) for key, value in asdict(params.train).items() if key != "exported"})


if __name__ == "__main__":
    main()
