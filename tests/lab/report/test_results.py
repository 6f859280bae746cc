from dataclasses import replace

import numpy as np
import pandas as pd

from calls import refused
from epiprior_lab.report.results import Rates, Results
from synthetic_tables import photograph_tables, study_tables


def errors(tables):
    return Rates(tables, tables.runs["error_px"])


def test_rates_are_shares_of_seeds_in_the_order_of_the_pairs_and_runs_are_unique(study):
    tables = study_tables(pairs=4)
    results = Results(tables, study.params)
    found = errors(replace(tables, runs=tables.runs.sample(frac=1, random_state=1))).of("usac", "default", 5.0)
    for k, pair in enumerate(tables.pairs.itertuples()):
        runs = tables.runs.query("group == @pair.group and pair_id == @pair.pair_id")
        runs = runs.query("estimator == 'usac' and input == 'default'")
        assert found[k] == np.mean([error < 5.0 for error in runs["error_px"]])  # NaN is no success
        assert results.scenes[k] == f"{pair.group}/{pair.scene}"
    assert results.estimators == ["usac", "prosac", "generalized-ransac", "epiprior"]
    assert results.inputs("generalized-ransac") == ["generalized", "snn", "default"]
    tables = study_tables(pairs=1)
    double = replace(tables, runs=pd.concat([tables.runs, tables.runs.iloc[:1]], ignore_index=True))
    refused(ValueError, "duplicate", errors, double)


def test_a_pair_without_runs_or_without_the_truth_is_a_failure(photographs):
    tables = photograph_tables()
    less = replace(tables, runs=tables.runs[tables.runs["pair_id"] != tables.pairs.iloc[0]["pair_id"]])
    assert np.isinf(errors(less)["usac", "default"][0]).all()
    poses = Results(tables, photographs.params).poses
    strecha = (tables.pairs["group"] == "strecha").to_numpy()  # no cameras
    assert np.isinf(poses["usac", "default"][strecha]).all()
    runs = tables.runs.query("group == 'fox' and estimator == 'usac' and input == 'default'")
    angles = runs[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False).fillna(np.inf)
    np.testing.assert_array_equal(poses["usac", "default"][tables.pairs["group"] == "fox"].ravel(), angles)
