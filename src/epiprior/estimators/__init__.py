"""Robust estimators of the fundamental matrix, each behind the same protocol.

For every backend epiprior recomputes the mask, makes F rank 2 and of unit norm, tells its status, and knows
whether the scene leaves F undecided.

Called like a function, ``epiprior.estimators()`` lists the estimators and what has to be installed for them.
"""

import sys
from types import ModuleType

from epiprior.estimators.protocol import Estimator, EstimatorSettings, RawModel
from epiprior.estimators.registry import estimators, find_estimator, fit, licences, names, run

__all__ = [
    "Estimator",
    "EstimatorSettings",
    "RawModel",
    "estimators",
    "find_estimator",
    "fit",
    "licences",
    "names",
    "run",
]


class _CallablePackage(ModuleType):
    """Lets ``epiprior.estimators`` be both this package and the list of its estimators."""

    def __call__(self) -> dict[str, str]:
        return estimators()


sys.modules[__name__].__class__ = _CallablePackage
