"""COLMAP's LO-RANSAC through pycolmap; it takes no prior, so what helps it is a short hand-over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.estimators.packages import package_version, what_to_install
from epiprior.estimators.protocol import EstimatorSettings, RawModel
from epiprior.types import MatchSet

_MIN_TRIALS = 100


@dataclass(frozen=True, kw_only=True)
class ColmapEstimator:
    """``pycolmap.estimate_fundamental_matrix``.

    Notes
    -----
    Points are passed with our pixel origin, so F comes back in it too: COLMAP's half pixel is no concern
    here. At most 10,000 trials: they cost 0.1 s on 300 matches.
    """

    name: str = "colmap"
    licence: str = "BSD-3-Clause"
    max_iterations: int = 10_000

    def missing(self) -> str:
        """Return what to install, or an empty string."""
        return what_to_install("pycolmap", "pycolmap>=4")

    def version(self) -> str:
        """Return pycolmap's version."""
        return package_version("pycolmap")

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Run ``pycolmap.estimate_fundamental_matrix`` on one thread; it tells no iteration count."""
        import pycolmap

        cap = settings.max_iterations or self.max_iterations
        options = pycolmap.RANSACOptions(
            max_error=settings.threshold_px,
            confidence=settings.confidence,
            min_num_trials=min(_MIN_TRIALS, cap),
            max_num_trials=cap,
            random_seed=seed,
            num_threads=1,
        )
        answer = pycolmap.estimate_fundamental_matrix(matches.x1, matches.x2, options)
        return RawModel(F=None if answer is None else np.asarray(answer["F"], dtype=np.float64))


ESTIMATORS = (ColmapEstimator(),)
