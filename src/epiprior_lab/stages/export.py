"""Stage `export`: the model folder of a preset, checked through the library that will load it."""

from __future__ import annotations

import argparse
from pathlib import Path

from epiprior_lab.export import export_model


def main() -> None:
    """Write ``models/<preset>/``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--preset", required=True, choices=("paper", "default"))
    preset = parser.parse_args().preset
    export_model(Path("data/training") / preset, Path("models") / preset, preset)


if __name__ == "__main__":
    main()
