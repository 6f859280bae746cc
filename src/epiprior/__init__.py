"""Matches of two photographs with calibrated probabilities, and their fundamental matrix.

>>> import epiprior
>>> ranked = epiprior.rank_matches("left.jpg", "right.jpg")  # doctest: +SKIP
>>> estimate = epiprior.estimate_fundamental("left.jpg", "right.jpg")  # doctest: +SKIP
"""

from __future__ import annotations

import os
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from epiprior.errors import (
        EpipriorError,
        EstimatorError,
        FeatureError,
        ImageError,
        ModelError,
        OutputError,
        SettingsError,
    )
    from epiprior.estimators import list_estimators
    from epiprior.estimators.handover import HandOver
    from epiprior.features.detect import FeatureSettings
    from epiprior.matching.baselines import generalized_matches, snn_matches, standard_matches
    from epiprior.presets import PreprocessSettings
    from epiprior.rank import rank_matches
    from epiprior.ranking.models import load_model
    from epiprior.two_view import estimate_fundamental
    from epiprior.types import Features, FundamentalEstimate, MatchSet, RankedMatches, Status
    from epiprior.verification.cascade import CascadeRule

__version__ = metadata.version("epiprior")

# onnxruntime 1.29 and later report what they run unless this is set before they are loaded. Nothing here phones home;
# and the thread that reports draws from the C library's rand(), in the middle of pydegensac's seeded draws.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

# Names are imported when they are first used, so that `epiprior --help` need not wait for compiled libraries.
_HOMES = {
    "CascadeRule": "verification.cascade",
    "EpipriorError": "errors",
    "EstimatorError": "errors",
    "FeatureError": "errors",
    "ImageError": "errors",
    "ModelError": "errors",
    "OutputError": "errors",
    "SettingsError": "errors",
    "FeatureSettings": "features.detect",
    "Features": "types",
    "FundamentalEstimate": "types",
    "HandOver": "estimators.handover",
    "MatchSet": "types",
    "PreprocessSettings": "presets",
    "RankedMatches": "types",
    "Status": "types",
    "estimate_fundamental": "two_view",
    "generalized_matches": "matching.baselines",
    "list_estimators": "estimators",
    "load_model": "ranking.models",
    "rank_matches": "rank",
    "snn_matches": "matching.baselines",
    "standard_matches": "matching.baselines",
}

__all__ = [
    "CascadeRule",
    "EpipriorError",
    "EstimatorError",
    "FeatureError",
    "FeatureSettings",
    "Features",
    "FundamentalEstimate",
    "HandOver",
    "ImageError",
    "MatchSet",
    "ModelError",
    "OutputError",
    "PreprocessSettings",
    "RankedMatches",
    "SettingsError",
    "Status",
    "__version__",
    "estimate_fundamental",
    "generalized_matches",
    "list_estimators",
    "load_model",
    "rank_matches",
    "snn_matches",
    "standard_matches",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
