"""Stage `export`: the model folder of every preset, checked through the library that will load it."""

from pathlib import Path

from epiprior_lab.export.model_folder import export_model
from epiprior_lab.params import load_study


def main() -> None:
    """Write ``models/<preset>/`` for every preset."""
    for preset in load_study().features.presets:
        export_model(Path("data/training") / preset, Path("models") / preset, preset)


if __name__ == "__main__":
    main()
