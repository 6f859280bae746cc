"""Settings that are out of range, and what the presets have in common."""

from dataclasses import replace

import pytest

from epiprior.errors import SettingsError
from epiprior.presets import DEFAULT, PRESETS, find_preset


@pytest.mark.parametrize(
    ("settings", "name", "value"),
    [
        (DEFAULT.features, "detector", "magic"),
        (DEFAULT.features, "max_image_size", 3),
        (DEFAULT.features, "max_keypoints", 1),
        (DEFAULT, "vote_threshold", -1.0),
        (DEFAULT, "frame", "nothing"),
        (DEFAULT, "nearest", float("nan")),
    ],
)
def test_bad_settings_are_named(settings, name, value):
    with pytest.raises(SettingsError, match=f"{name} is {value!r}"):
        replace(settings, **{name: value})


def test_an_unknown_preset_is_named():
    with pytest.raises(SettingsError, match="'fancy', known: paper, fast, default, thorough"):
        find_preset("fancy")


def test_presets_of_one_model_differ_in_their_features_alone():
    """The model was trained on the columns of the preset that has its name."""
    for preset in PRESETS.values():
        assert preset.model in PRESETS
        if preset.model != preset.name:
            trained = PRESETS[preset.model]
            assert replace(preset, name=trained.name, features=trained.features) == trained
