"""Settings that are out of range, and what the presets have in common."""

from dataclasses import replace

import pytest

from epiprior.errors import SettingsError
from epiprior.presets import DEFAULT, PAPER, find_preset


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
    with pytest.raises(SettingsError, match="'fancy', known: paper, default"):
        find_preset("fancy")


def test_presets_find_the_same_features():
    """A cascade shares them between the standard matches of the paper and the preset that ranks."""
    assert replace(DEFAULT.features, root=PAPER.features.root, centred=PAPER.features.centred) == PAPER.features
