"""What an estimator is given and what it returns, before epiprior looks at the answer."""

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import metadata

from epiprior.errors import SettingsError
from epiprior.types import FloatArray, MatchSet

SEED_LIMIT = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class EstimatorSettings:
    """Settings that every estimator understands; SettingsError for a value out of its range.

    Backends with another residual get the same threshold; the mask is recomputed by epiprior in any case.
    """

    threshold_px: float = 1.5  # inlier threshold on the (unsquared) Sampson distance, pixels, > 0
    confidence: float = 0.99  # wanted probability of having drawn an outlier-free sample, in (0, 1)
    max_iterations: int | None = None  # cap on the hypotheses drawn, >= 1; None: the estimator's own

    def __post_init__(self) -> None:
        if not 0 < self.threshold_px < float("inf"):
            raise SettingsError(f"threshold_px is {self.threshold_px}, expected a positive number of pixels")
        if not 0 < self.confidence < 1:
            raise SettingsError(f"confidence is {self.confidence}, expected a number between 0 and 1")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise SettingsError(f"max_iterations is {self.max_iterations}, expected at least 1")


@dataclass(frozen=True, kw_only=True)
class RawModel:
    """The answer of a backend, unchecked."""

    F: FloatArray | None  # may be a stack of matrices, zero, or not finite; None if the backend gave none
    iterations: int | None = None  # hypotheses drawn, where the backend tells


@dataclass(frozen=True, kw_only=True)
class Estimator(ABC):
    """One robust estimator of the fundamental matrix, by default one that needs epiprior alone.

    An estimator is called with distinct, finite matches in the order of the ranking, best first, and may use of them
    what it can: the order, `MatchSet.probability`, scale and orientation, or the rough matrices. It must be
    deterministic given `seed`, and must not raise because the matches are bad.
    """

    name: str  # in the registry
    max_iterations: int  # cap on the hypotheses drawn where the settings give none
    licence: str = "BSD-3-Clause"  # of the backend

    def missing(self) -> str:
        """Return what to install, or an empty string if the estimator can run."""
        return ""

    def version(self) -> str:
        """Return the backend's package and version."""
        return package_version("epiprior")

    @abstractmethod
    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Return the backend's F for at least 8 distinct matches; `seed` is in [0, 2**31 - 1)."""


@functools.cache  # parsing the metadata takes milliseconds, and every estimate carries a version
def package_version(package: str) -> str:
    """Return ``package version`` as installed, or `package` alone where it carries no metadata."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return package
