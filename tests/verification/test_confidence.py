"""The model of the confidence: read whole or refused, and what follows from its probabilities."""

import functools
import json
import shutil
from dataclasses import replace
from operator import getitem

import numpy as np
import pytest

from calls import refused
from epiprior.errors import ModelError
from epiprior.ranking.models import find_model
from epiprior.types import Geometry, Status
from epiprior.verification.confidence import CONFIDENCE_TARGETS, ConfidenceModel, judge, load_confidence
from synthetic import make_pair
from synthetic_facts import facts_of


class Fixed:
    """A classifier that always says the same."""

    columns = ("support", "share")

    def __init__(self, value):
        self.value = value

    def __call__(self, rows):
        assert rows.shape == (1, 2)
        return np.array([self.value])


@pytest.fixture(scope="module")
def facts():
    pair = make_pair()
    return facts_of(pair.F, pair.matches)


def verdict(facts, right, flat, kind=Geometry.PLANAR, **options):
    return judge(facts, kind, ConfidenceModel({}, Fixed(right), Fixed(flat), 0.25), **options)


def test_status_geometry_and_message_follow_from_both_probabilities(facts):
    sure = verdict(facts, 0.9, 0.05)
    assert (sure.status, sure.geometry, sure.confidence, sure.message) == (Status.OK, Geometry.GENERAL, 0.9, "")
    flat = verdict(facts, 0.3, 0.9)
    assert (flat.status, flat.geometry) == (Status.DEGENERATE, Geometry.PLANAR)
    assert flat.message == "one plane: F is not determined"
    assert "copies" in verdict(facts, 0.1, 0.9, Geometry.IDENTICAL).message
    unsure = verdict(facts, 0.5, 0.05, min_confidence=0.6)
    for found in (verdict(facts, 0.1, 0.05), verdict(facts, 0.1, 0.9, None), unsure):
        assert (found.status, found.geometry) == (Status.NO_MODEL, Geometry.NONE)
        assert "no more agreement than between photographs of different places" in found.message
    on_overlay = replace(facts, apart=0.1)
    assert "watermark" in verdict(on_overlay, 0.1, 0.05).message
    assert verdict(on_overlay, 0.9, 0.05).status is Status.OK


def test_the_packaged_model_takes_facts_of_this_version():
    model = load_confidence()
    for target, columns in CONFIDENCE_TARGETS.items():
        assert getattr(model, target).columns == columns
    assert 0 < model.min_confidence < 1
    assert model.manifest["min_confidence"] == model.min_confidence
    assert load_confidence() is model


def test_a_damaged_model_is_refused(tmp_path):
    folder = shutil.copytree(find_model("confidence"), tmp_path / "confidence")
    text = (folder / "manifest.json").read_text()
    for keys, value, message in (
        (("min_confidence",), 1.5, r"min_confidence is 1\.5"),
        (("min_confidence",), None, "min_confidence is None"),
        (("confidence", "features", 0), "weather", "weather"),
    ):
        manifest = json.loads(text)
        functools.reduce(getitem, keys[:-1], manifest)[keys[-1]] = value
        (folder / "manifest.json").write_text(json.dumps(manifest))
        refused(ModelError, message, load_confidence, folder)
    refused(ModelError, "no such folder", load_confidence, folder / "nowhere")
