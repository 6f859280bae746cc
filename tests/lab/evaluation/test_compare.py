"""Success rates per pair and their paired comparison."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from epiprior_lab.evaluation.compare import ALL, POSE, Rates, group_masks
from synthetic_tables import APART, photograph_tables, study_tables


def test_rates_are_shares_of_seeds_in_the_order_of_the_pairs_and_runs_are_unique():
    tables = study_tables(pairs=4)
    rates = Rates(replace(tables, runs=tables.runs.sample(frac=1, random_state=1)))
    found = rates.of("usac", "default", 5.0)
    for k, pair in enumerate(tables.pairs.itertuples()):
        runs = tables.runs.query(
            "group == @pair.group and pair_id == @pair.pair_id and estimator == 'usac' and input == 'default'"
        )
        assert found[k] == np.mean([error < 5.0 for error in runs["error_px"]])  # NaN is no success
        assert rates.scenes[k] == f"{pair.group}/{pair.scene}"
    assert Rates(tables).estimators == ["usac", "prosac", "generalized-ransac", "epiprior"]
    assert Rates(tables).inputs("generalized-ransac") == ["generalized", "snn", "default"]
    tables = study_tables(pairs=1)
    double = replace(tables, runs=pd.concat([tables.runs, tables.runs.iloc[:1]]))
    with pytest.raises(ValueError, match="duplicate"):
        Rates(double).values("usac", "standard")


def test_a_pair_without_runs_or_without_the_truth_is_a_failure():
    tables = photograph_tables()
    less = replace(tables, runs=tables.runs[tables.runs["pair_id"] != tables.pairs.iloc[0]["pair_id"]])
    assert np.isinf(Rates(less).values("usac", "default")[0]).all()
    poses = Rates(tables, POSE)
    strecha = (tables.pairs["group"] == "strecha").to_numpy()  # no cameras
    assert np.isinf(poses.values("usac", "default")[strecha]).all()
    runs = tables.runs.query("group == 'fox' and estimator == 'usac' and input == 'default'")
    angles = runs[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False).fillna(np.inf)
    np.testing.assert_array_equal(poses.values("usac", "default")[tables.pairs["group"] == "fox"].ravel(), angles)


def test_groups_leave_out_what_is_apart():
    masks = group_masks(photograph_tables().pairs, apart=APART)
    assert list(masks) == ["easy", "medium", "hard", ALL, "strecha", "fox", "scannet15"]
    assert masks[ALL].sum() == 12
    assert not (masks["hard"] & masks["scannet15"]).any()
    assert masks["scannet15"].sum() == 6
    assert masks["easy"].sum() + masks["medium"].sum() == 5  # one pair of strecha has no labels


def test_runs_are_unique():
    tables = study_tables(pairs=1)
    double = replace(tables, runs=pd.concat([tables.runs, tables.runs.iloc[:1]]))
    with pytest.raises(ValueError, match="duplicate"):
        Rates(double).values("usac", "standard")
