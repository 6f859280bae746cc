"""Settings that are out of range, and what the presets have in common."""

from dataclasses import replace

import pytest

from epiprior.errors import SettingsError
from epiprior.presets import DEFAULT, PAPER, FeatureSettings, find_preset


@pytest.mark.parametrize("bad", [{"detector": "magic"}, {"max_image_size": 3}, {"max_keypoints": 1}])
def test_bad_settings_are_named(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        FeatureSettings(**bad)


@pytest.mark.parametrize("bad", [{"vote_threshold": -1.0}, {"frame": "nothing"}, {"nearest": float("nan")}])
def test_bad_numbers_of_the_method_are_named(bad):
    ((name, value),) = bad.items()
    with pytest.raises(SettingsError, match=f"{name} is {value!r}"):
        replace(DEFAULT, **bad)


def test_an_unknown_preset_is_named():
    with pytest.raises(SettingsError, match="'fancy', known: paper, default"):
        find_preset("fancy")


def test_presets_find_the_same_features():
    """A cascade shares them between the standard matches of the paper and the preset that ranks."""
    assert replace(DEFAULT.features, root=PAPER.features.root, centred=PAPER.features.centred) == PAPER.features
