"""Stage `train`: compare the families of classifiers for both targets, and refit the ones that are exported."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from epiprior.models import TARGETS
from epiprior_lab import training_tables, two_stages
from epiprior_lab.parallel import default_workers
from epiprior_lab.params import load_params
from epiprior_lab.rows import load_rows
from epiprior_lab.tracking import TrackedFamily, track


def main() -> None:
    """Write ``data/training/<preset>/`` and ``data/timings/train-<preset>.csv``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--preset", required=True, choices=("paper", "default"))
    preset = parser.parse_args().preset
    params = load_params().train
