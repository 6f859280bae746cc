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
    from epiprior.collection.run import MatchedCollection as MatchedCollection
    from epiprior.collection.run import match_collection as match_collection
    from epiprior.collection.store import MatchedPair as MatchedPair
    from epiprior.errors import EpipriorError as EpipriorError
    from epiprior.errors import EstimatorError as EstimatorError
    from epiprior.errors import FeatureError as FeatureError
    from epiprior.errors import ImageError as ImageError
    from epiprior.errors import ModelError as ModelError
    from epiprior.errors import OutputError as OutputError
    from epiprior.errors import SettingsError as SettingsError
    from epiprior.estimators.essential import Intrinsics as Intrinsics
    from epiprior.estimators.handover import HandOver as HandOver
    from epiprior.estimators.registry import list_estimators as list_estimators
    from epiprior.explain import Explanation as Explanation
    from epiprior.explain import explain_match as explain_match
    from epiprior.matching.baselines import generalized_matches as generalized_matches
    from epiprior.matching.baselines import snn_matches as snn_matches
    from epiprior.matching.baselines import standard_matches as standard_matches
    from epiprior.presets import FeatureSettings as FeatureSettings
    from epiprior.presets import PreprocessSettings as PreprocessSettings
    from epiprior.rank import rank_matches as rank_matches
    from epiprior.ranking.models import load_model as load_model
    from epiprior.two_view import estimate_fundamental as estimate_fundamental
    from epiprior.types import Features as Features
    from epiprior.types import FundamentalEstimate as FundamentalEstimate
    from epiprior.types import Geometry as Geometry
    from epiprior.types import MatchSet as MatchSet
    from epiprior.types import RankedMatches as RankedMatches
    from epiprior.types import Status as Status
    from epiprior.verification.cascade import CascadeRule as CascadeRule

__version__ = metadata.version("epiprior")

# onnxruntime 1.29 and later report what they run unless this is set before they are loaded. Nothing here phones home;
# and the thread that reports draws from the C library's rand(), in the middle of pydegensac's seeded draws.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

# Public names and their modules. They are imported when first used: `epiprior --help` needs no compiled library.
_NAMES = {
    "collection.run": ("MatchedCollection", "match_collection"),
    "collection.store": ("MatchedPair",),
    "errors": (
        "EpipriorError", "EstimatorError", "FeatureError", "ImageError", "ModelError", "OutputError", "SettingsError",
    ),
    "estimators.essential": ("Intrinsics",),
    "estimators.handover": ("HandOver",),
    "estimators.registry": ("list_estimators",),
    "explain": ("Explanation", "explain_match"),
    "matching.baselines": ("generalized_matches", "snn_matches", "standard_matches"),
    "presets": ("FeatureSettings", "PreprocessSettings"),
    "rank": ("rank_matches",),
    "ranking.models": ("load_model",),
    "two_view": ("estimate_fundamental",),
    "types": ("Features", "FundamentalEstimate", "Geometry", "MatchSet", "RankedMatches", "Status"),
    "verification.cascade": ("CascadeRule",),
}  # fmt: skip
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(["__version__", *_MODULES])
