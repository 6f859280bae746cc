"""All estimators by name, and the one way to run them."""

import time
from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np

from epiprior.errors import EstimatorError, FeatureError, SettingsError
from epiprior.estimators import backends, epiprior, own
from epiprior.estimators.protocol import SEED_LIMIT, Estimator
from epiprior.geometry import MIN_MATCHES, as_points, first_of_equal, normalise_fundamental
from epiprior.types import FloatArray, MatchSet, Status
from epiprior.verification.chance import distinct_count

_REGISTRY: dict[str, Estimator] = {
    estimator.name: estimator for module in (backends, own, epiprior) for estimator in module.ESTIMATORS
}


def names() -> tuple[str, ...]:
    """Return the names of all estimators, installed or not."""
    return tuple(_REGISTRY)


def list_estimators() -> dict[str, str]:
    """Return, for each estimator, ``available`` or the command that installs what it needs."""
    return {name: estimator.missing() or "available" for name, estimator in _REGISTRY.items()}


def licences() -> dict[str, str]:
    """Return the licence of what each estimator runs."""
    return {name: estimator.licence for name, estimator in _REGISTRY.items()}


def find_estimator(name: str) -> Estimator:
    """Return the estimator called `name`, or raise EstimatorError if there is none or its backend is not installed."""
    estimator = _REGISTRY.get(name)
    if estimator is None:
        raise EstimatorError(f"unknown estimator {name!r}, known: {', '.join(_REGISTRY)}")
    missing = estimator.missing()
    if missing:
        raise EstimatorError(f"estimator {name} is not installed: {missing}")
    return estimator


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A checked but not yet verified answer."""

    F: FloatArray | None  # normalised; None where `status` is not ``ok``
    status: Status  # ``ok``, ``too_few_matches`` or ``no_model``
    message: str  # why it is not ``ok``
    iterations: int | None  # hypotheses drawn, where the backend tells
    version: str  # of the backend: package and version
    seconds: float


def with_checked_points(matches: MatchSet) -> MatchSet:
    """Return matches whose points are finite numbers, as many in both images; FeatureError if they are not."""
    x1, x2 = as_points("x1", matches.x1), as_points("x2", matches.x2)
    if len(x1) != len(x2):
        raise FeatureError(f"x1 holds {len(x1)} points and x2 {len(x2)}, expected as many")
    return replace(matches, x1=x1, x2=x2)


def fit(name: str, matches: MatchSet, *, seed: int = 0, threshold_px: float = 1.5) -> Fit:
    """Run one estimator and check that its matrix is finite and of rank 2, but not whether it means anything.

    Matches are sorted best first. Of matches at identical points the first counts: repeated ones would make samples
    singular, and count twice. The same `seed` >= 0 gives the same bytes. `threshold_px` is on the Sampson distance.

    Raises EstimatorError if the estimator is unknown or not installed, FeatureError if points are not finite or their
    numbers disagree, SettingsError if the seed is negative or no integer.
    """
    estimator = find_estimator(name)
    if not isinstance(seed, Integral) or seed < 0:
        raise SettingsError(f"seed is {seed!r}, expected an integer, at least 0")
    matches = with_checked_points(matches)
    first = first_of_equal(np.column_stack([matches.x1, matches.x2]))
    distinct = matches if len(first) == len(matches) else matches.take(first)
    start = time.perf_counter()
    F, status, message, iterations = None, Status.OK, "", None
    count = distinct_count(distinct.x1, distinct.x2)
    if count < MIN_MATCHES:
        status, message = Status.TOO_FEW_MATCHES, f"{count} distinct matches, at least {MIN_MATCHES} are needed"
    else:
        raw, iterations = estimator.run(distinct, threshold_px, estimator.max_iterations, int(seed) % SEED_LIMIT)
        F = None if raw is None else normalise_fundamental(raw)
        if F is None:
            status, message = Status.NO_MODEL, "the estimator found no finite matrix of rank 2"
    seconds = time.perf_counter() - start
    return Fit(F=F, status=status, message=message, iterations=iterations, version=estimator.version(), seconds=seconds)
