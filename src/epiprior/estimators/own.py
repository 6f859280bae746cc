"""What our own estimators have in common: a recipe for the loop, a prior, a cap on the samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from epiprior.estimators.loop import Recipe, run_loop, search
from epiprior.estimators.packages import package_version
from epiprior.estimators.protocol import EstimatorSettings, RawModel
from epiprior.kernels.compilation import announce_compilation
from epiprior.types import FloatArray, MatchSet


@dataclass(frozen=True, kw_only=True)
class LoopEstimator:
    """An estimator that runs in the compiled loop (`epiprior.estimators.loop`).

    Parameters
    ----------
    name : str
        Name in the registry.
    recipe : Recipe
        Its parts.
    prior : callable
        Gives the weight of each match in sampling, shape (N,), in [0, 1].
    max_iterations : int
        Cap on the samples drawn.
    """

    name: str
    recipe: Recipe
    prior: Callable[[MatchSet], FloatArray]
    max_iterations: int
    licence: str = "BSD-3-Clause"

    def missing(self) -> str:
        """Return an empty string: it is part of epiprior."""
        return ""

    def version(self) -> str:
        """Return epiprior's version."""
        return package_version("epiprior")

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Run the loop; a sample may give up to three hypotheses, `iterations` counts samples."""
        announce_compilation(run_loop, "our own estimators", "about twenty seconds")
        return search(
            matches,
            self.prior(matches),
            self.recipe,
            threshold_px=settings.threshold_px,
            confidence=settings.confidence,
            max_iterations=settings.max_iterations or self.max_iterations,
            seed=seed,
        )
