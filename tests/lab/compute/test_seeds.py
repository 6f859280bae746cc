from epiprior_lab.compute.seeds import child_seed


def test_known_values_never_change_others_differ_and_all_fit_every_library():
    # Published results belong to these seeds.
    assert (child_seed(0), child_seed(0, "a", "b")) == (1484405855, 1253189842)
    calls = [(0, "a", "bc"), (1, "a", "bc"), (0, "ab", "c"), (0, "bc", "a"), (0, "a"), (0,)]
    assert len({child_seed(*call) for call in calls}) == len(calls)
    seeds = [child_seed(2**31 - 1, f"pair-{i}") for i in range(500)]
    assert min(seeds) >= 0
    assert 2**30 < max(seeds) < 2**31  # the range is used
    assert all(type(seed) is int for seed in seeds)
