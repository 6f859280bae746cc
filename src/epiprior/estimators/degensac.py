"""DEGENSAC through pydegensac; it takes no prior, so what helps it is a short hand-over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.estimators.packages import package_version, what_to_install
from epiprior.estimators.protocol import EstimatorSettings, RawModel
from epiprior.types import MatchSet


@dataclass(frozen=True, kw_only=True)
class DegensacEstimator:
    """``pydegensac.findFundamentalMatrix`` with its check of degenerate samples.

    Notes
    -----
    It answers a failure with a zero matrix. A negative seed would make it draw from the clock; ours never is.
    """

    name: str = "degensac"
    licence: str = "MIT"
    max_iterations: int = 20_000

    def missing(self) -> str:
        """Return what to install, or an empty string."""
        return what_to_install("pydegensac", "epiprior[degensac]")

    def version(self) -> str:
        """Return pydegensac's version."""
        return package_version("pydegensac")

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Run ``pydegensac.findFundamentalMatrix``; it tells no iteration count."""
        import pydegensac  # type: ignore[import-not-found, unused-ignore]

        F, _ = pydegensac.findFundamentalMatrix(
            matches.x1,
            matches.x2,
            px_th=settings.threshold_px,
            conf=settings.confidence,
            max_iters=settings.max_iterations or self.max_iterations,
            error_type="sampson",
            enable_degeneracy_check=True,
            seed=seed,
        )
        return RawModel(F=np.asarray(F, dtype=np.float64))


ESTIMATORS = (DegensacEstimator(),)
