"""Robust estimators of the fundamental matrix, each behind the same protocol.

Of every backend epiprior recomputes the mask, makes F rank 2 and of unit norm, and judges whether F is decided.
"""

from epiprior.estimators.protocol import Estimator
from epiprior.estimators.registry import find_estimator, fit, licences, list_estimators, names

__all__ = ["Estimator", "find_estimator", "fit", "licences", "list_estimators", "names"]
