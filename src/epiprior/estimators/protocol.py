"""What an estimator is given and what it returns, before epiprior looks at the answer."""

import functools
from dataclasses import dataclass
from importlib import metadata
from typing import Protocol

from epiprior.errors import SettingsError
from epiprior.types import FloatArray, MatchSet

SEED_LIMIT = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class EstimatorSettings:
    """Settings that every estimator understands.

    Parameters
    ----------
    threshold_px : Inlier threshold on the (unsquared) Sampson distance, pixels, > 0. Backends with another residual get
        the same number; the mask is recomputed by epiprior in any case.
    confidence : Wanted probability of having drawn an outlier-free sample, in (0, 1).
    max_iterations : Cap on the hypotheses drawn, >= 1. None: the estimator's own (`Estimator.max_iterations`).

    Raises
    ------
    SettingsError : If a value is out of its range.
    """

    threshold_px: float = 1.5
    confidence: float = 0.99
    max_iterations: int | None = None

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


class Estimator(Protocol):
    """One robust estimator of the fundamental matrix.

    An estimator is called with distinct, finite matches in the order of the ranking, best first, and may use of them
    what it can: the order, `MatchSet.probability`, scale and orientation, or the rough matrices. It must be
    deterministic given `seed`, and must not raise because the matches are bad.
    """

    @property
    def name(self) -> str:
        """Name in the registry."""

    @property
    def licence(self) -> str:
        """Licence of the backend."""

    @property
    def max_iterations(self) -> int:
        """Cap on the hypotheses drawn where the settings give none."""

    def missing(self) -> str:
        """Return what to install, or an empty string if the estimator can run."""

    def version(self) -> str:
        """Return the backend's package and version."""

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Return the backend's F for at least 8 distinct matches; `seed` is in [0, 2**31 - 1)."""


class PartOfEpiprior:
    """An estimator that needs no package beside epiprior's own dependencies."""

    def missing(self) -> str:
        """Return an empty string."""
        return ""

    def version(self) -> str:
        """Return epiprior's version."""
        return package_version("epiprior")


@functools.cache  # parsing the metadata takes milliseconds, and every estimate carries a version
def package_version(package: str) -> str:
    """Return ``package version`` as installed, or `package` alone where it carries no metadata."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return package
