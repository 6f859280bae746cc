"""How sure an estimate is: two learnt classifiers over its facts, and the verdict that follows from them.

A model is a folder, as those of the rankings: ``confidence.onnx`` gives the probability that F is right,
``homography.onnx`` the probability that the two images are related by a homography, which leaves F undecided.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import ModelError, SettingsError
from epiprior.presets import check_number
from epiprior.ranking.models import Classifier, find_model, read_classifiers
from epiprior.types import Geometry, Status
from epiprior.verification.facts import COLUMNS, Facts

# Columns of both classifiers. How many matches there are says nothing of whether a homography explains them.
CONFIDENCE_TARGETS = {
    "confidence": COLUMNS,
    "homography": (
        "plane_tight", "plane", "plane_all", "plane_by_chance", "off_plane_by_chance", "parallax_by_chance",
        "plane_residual", "relief", "copy_residual", "in_place", "apart", "share",
    ),
}  # fmt: skip
MODEL = "confidence"
_OVERLAY_SHARE = 0.2
_FLAT = 0.3  # where a homography is likelier than a right F; on unrelated pairs its probability is below 0.02
MESSAGES = {  # why a homography leaves F undecided
    Geometry.PLANAR: "one plane: F is not determined",
    Geometry.ROTATION: "the camera only turned or zoomed: F is not determined",
    Geometry.IDENTICAL: "copies of one picture, or nothing moved: F is not determined",
}
_NO_MORE = "no more agreement than between photographs of different places"
_OVERLAY = "the matches agree only on something that does not move with the scene (a watermark, time stamp or border)"


@dataclass(frozen=True)
class ConfidenceModel:
    """The two classifiers over `facts.COLUMNS`, and the confidence from which on an F is relied on."""

    manifest: Mapping[str, Any]
    confidence: Classifier
    homography: Classifier
    min_confidence: float

    def probabilities(self, facts: Facts) -> tuple[float, float]:
        """Return the probabilities, in (0, 1), that F is right and that a homography relates the images."""
        row, place = facts.row(), {name: k for k, name in enumerate(COLUMNS)}
        of = [row[None, [place[name] for name in c.columns]] for c in (self.confidence, self.homography)]
        return float(self.confidence(of[0])[0]), float(self.homography(of[1])[0])


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What is said of an F."""

    status: Status
    geometry: Geometry
    confidence: float
    message: str = ""


def judge(facts: Facts, kind: Geometry | None, model: ConfidenceModel, min_confidence: float | None = None) -> Verdict:
    """Return the verdict on an F by its facts.

    `kind` is that of its best homography (`kind_of_homography`), if any; `min_confidence` replaces the model's.
    """
    right, flat = model.probabilities(facts)
    least = model.min_confidence if min_confidence is None else min_confidence
    if kind is not None and flat >= _FLAT and flat > right:
        return Verdict(status=Status.DEGENERATE, geometry=kind, confidence=right, message=MESSAGES[kind])
    if right >= least:
        return Verdict(status=Status.OK, geometry=Geometry.GENERAL, confidence=right)
    if facts.apart < _OVERLAY_SHARE:
        return Verdict(status=Status.DEGENERATE, geometry=Geometry.NONE, confidence=right, message=_OVERLAY)
    doubt = f"{_NO_MORE}: confidence {right:.2f}, at least {least:.2f} is asked for"
    return Verdict(status=Status.NO_MODEL, geometry=Geometry.NONE, confidence=right, message=doubt)


@functools.cache
def load_confidence(folder: Path | None = None) -> ConfidenceModel:
    """Return the model in a folder, by default the one that comes with epiprior; read once.

    ModelError if it is missing or damaged, or was made for other facts than those of this epiprior.
    """
    found = folder or find_model(MODEL)
    manifest, (right, flat) = read_classifiers(found, tuple(CONFIDENCE_TARGETS))
    unknown = sorted({*right.columns, *flat.columns} - set(COLUMNS))
    if unknown:
        raise ModelError(f"{found}: made of facts that this epiprior does not have: {', '.join(unknown)}")
    least = manifest.get("min_confidence")
    try:
        check_number("min_confidence", least, 0.0, 1.0)
    except SettingsError as error:
        raise ModelError(f"{found}: {error}") from error
    return ConfidenceModel(manifest, right, flat, float(np.float64(least)))
