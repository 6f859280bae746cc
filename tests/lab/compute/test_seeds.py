import pytest

from epiprior.errors import SettingsError
from epiprior_lab.compute.seeds import child_seed


def test_known_values_never_change():
    # Published results belong to these seeds.
    assert (child_seed(0), child_seed(0, "a", "b")) == (1484405855, 1253189842)


def test_children_differ_by_base_name_order_and_boundaries():
    seeds = [
        child_seed(0, "a", "bc"),
        child_seed(1, "a", "bc"),
        child_seed(0, "ab", "c"),
        child_seed(0, "bc", "a"),
        child_seed(0, "a"),
        child_seed(0),
    ]
    assert len(set(seeds)) == len(seeds)


def test_seeds_fit_every_library():
    seeds = [child_seed(2**31 - 1, f"pair-{i}") for i in range(500)]
    assert min(seeds) >= 0
    assert max(seeds) < 2**31
    assert max(seeds) > 2**30  # the range is used
    assert all(type(seed) is int for seed in seeds)


def test_negative_base_is_named():
    with pytest.raises(SettingsError, match="seed = -1"):
        child_seed(-1, "a")
