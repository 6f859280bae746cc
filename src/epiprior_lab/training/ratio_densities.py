"""Learn both tables of the ratio prior from the rendered training scenes; run as a module, it prints them."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from epiprior.estimators.ratio_prior import density
from epiprior.matching.baselines import standard_matches
from epiprior.types import FloatArray
from epiprior_lab.labels.ground_truth import label_matches
from epiprior_lab.pairsets import Pair, read_pair_set


def learn_densities(pairs: Iterable[Pair]) -> tuple[FloatArray, FloatArray]:
    """Return the densities of d_r of right and of wrong nearest neighbours; all pairs that have such count alike."""
    densities: dict[bool, list[FloatArray]] = {True: [], False: []}
    for pair in pairs:
        matches = standard_matches(pair.image1, pair.image2, max_distance_ratio=1.0)
        labels = label_matches(pair, matches.x1, matches.x2, matches.scale1, matches.scale2)
        for right in set(labels.tolist()):
            densities[right].append(density(matches.distance_ratio[labels == right]))
    return np.mean(densities[True], axis=0), np.mean(densities[False], axis=0)


def main() -> None:
    """Print both tables."""
    folders = sorted(folder for folder in Path("data/scenes/train").iterdir() if folder.is_dir())
    tables = learn_densities(pair for folder in folders for pair in read_pair_set(folder).pairs)
    for name, table in zip(("DENSITY_IN", "DENSITY_OUT"), tables, strict=True):
        print(name, np.array2string(table, precision=4, separator=", ", floatmode="fixed"))  # noqa: T201


if __name__ == "__main__":
    main()
