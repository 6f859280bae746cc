"""Densities of the distance ratio of right and wrong nearest neighbours: the constants of the ratio prior.

    python -m epiprior_lab.training.ratio_densities

reads the rendered training scenes and prints the two tables of `epiprior.estimators.ratio_prior`. Only these scenes
enter, never validation, test or photographs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from epiprior.estimators.ratio_prior import density
from epiprior.matching.baselines import standard_matches
from epiprior.types import FloatArray
from epiprior_lab.evaluation.estimates import study_pairs
from epiprior_lab.labels.ground_truth import label_matches
from epiprior_lab.pairsets import Pair


def learn_densities(pairs: Sequence[Pair]) -> tuple[FloatArray, FloatArray]:
    """Return the densities of d_r of right and of wrong nearest neighbours, on the grid of the ratio prior.

    Parameters
    ----------
    pairs : sequence of Pair
        With ground truth. Every pair counts alike, however many matches it has.
    """
    right: list[FloatArray] = []
    wrong: list[FloatArray] = []
    for pair in pairs:
        matches = standard_matches(pair.image1, pair.image2, max_distance_ratio=1.0)
        labels = label_matches(pair, matches.x1, matches.x2, matches.scale1, matches.scale2)
        for tables, members in ((right, labels), (wrong, ~labels)):
            if members.any():
                tables.append(density(matches.distance_ratio[members]))
    return np.mean(right, axis=0), np.mean(wrong, axis=0)


def main() -> None:
    """Print both tables."""
    families = sorted(folder.name for folder in Path("data/scenes/train").iterdir() if folder.is_dir())
    pairs = [pair for family in families for pair in study_pairs("train", family)]
    for name, table in zip(("DENSITY_IN", "DENSITY_OUT"), learn_densities(pairs), strict=True):
        print(name, np.array2string(table, precision=4, separator=", ", floatmode="fixed"))  # noqa: T201


if __name__ == "__main__":
    main()
