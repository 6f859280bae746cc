"""Settings that are out of range, and what the presets have in common."""

from dataclasses import replace

import pytest

from calls import refused
from epiprior.draw.pictures import DrawSettings
from epiprior.errors import SettingsError
from epiprior.estimators.handover import HandOver
from epiprior.presets import DEFAULT, PRESETS, find_preset
from epiprior.verification.cascade import CascadeRule

NAN = float("nan")


@pytest.mark.parametrize(
    ("settings", "bad"),
    [
        (DEFAULT.features, {"detector": ["magic"], "max_image_size": [3], "max_keypoints": [1]}),
        (DEFAULT, {"vote_threshold": [-1.0], "frame": ["nothing"], "nearest": [NAN]}),
        (HandOver(), {"top_k": [7, 300.0, True], "max_distance_ratio": [0.0, NAN], "threshold_px": [0.0, None]}),
        (HandOver(), dict.fromkeys(("one_to_one", "collect", "refine"), (1, "yes", None))),
        (DrawSettings(), {"max_matches": [0], "epipolar_lines": [9], "max_panel_size": [100]}),
        (CascadeRule(), {"min_confidence": [-0.1, 1.1, NAN, None, True, "0.9"]}),
    ],
)
def test_bad_settings_are_named(settings, bad):
    for name, value in ((name, value) for name, values in bad.items() for value in values):
        refused(SettingsError, f"{name} is {value!r}", replace, settings, **{name: value})


def test_an_unknown_preset_is_named():
    refused(SettingsError, "'fancy', known: paper, fast, default, thorough", find_preset, "fancy")


def test_presets_of_one_model_differ_in_their_features_alone():
    """The model was trained on the columns of the preset that has its name."""
    for preset in PRESETS.values():
        assert preset.model in PRESETS
        if preset.model != preset.name:
            trained = PRESETS[preset.model]
            assert replace(preset, name=trained.name, features=trained.features) == trained
