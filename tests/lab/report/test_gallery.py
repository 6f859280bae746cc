"""Pairs of the gallery change sides as they say."""

from dataclasses import replace

import pytest

from epiprior_lab.report.pictures import choose_cases
from epiprior_lab.report.results import Results
from synthetic_tables import APART, PHOTOGRAPH_INPUTS


def sides(results, pair, estimator, against):
    """Share of the runs of an estimator that succeed on one pair: on another input, and on ours."""
    runs = results.tables.runs
    own = runs[(runs["group"] == pair[0]) & (runs["pair_id"] == pair[1]) & (runs["estimator"] == estimator)]
    shares = (own["error_px"] < 10).groupby(own["input"]).mean()
    return shares[against], shares["default"]


def changed(photographs, **columns):
    tables = photographs.results.tables
    return Results(replace(tables, runs=tables.runs.assign(**columns)), photographs.params, apart=APART)


@pytest.fixture
def swapped(photographs):
    """The same results, ours and `snn` in each other's place, so that pairs are lost."""
    names = photographs.results.tables.runs["input"].replace({"default": "snn", "snn": "default"})
    return changed(photographs, input=names)


@pytest.mark.parametrize("lost", [False, True])
def test_cases_changed_sides(photographs, swapped, lost):
    results = swapped if lost else photographs.results
    cases = choose_cases(results, "usac", rescued=3, lost=2, success_px=10.0)
    assert ("lost" if lost else "rescued") in {case.kind for case in cases}
    status = results.tables.runs.set_index(["group", "pair_id", "estimator", "input", "seed"])["status"]
    for case in cases:
        assert case.group not in APART
        pair = (case.group, case.pair_id)
        before, after = sides(results, pair, case.estimator, case.inputs[0])
        assert case.succeeded == (before, after)
        assert (before < 0.5 < after) if case.kind == "rescued" else (after < 0.5 < before)
        drawn = zip(case.inputs, case.seeds, strict=True)
        assert case.statuses == tuple(status[(*pair, case.estimator, name, seed)] for name, seed in drawn)
        assert case.kind == "lost" or (case.statuses[1] == "ok" and case.estimator == "usac")
        assert 1 <= case.changed <= case.of == len(PHOTOGRAPH_INPUTS)
    rescued = [case.right_share for case in cases if case.kind == "rescued"]
    assert rescued == sorted(rescued)
    assert len(rescued) <= 3


def test_lost_pairs_are_those_that_most_estimators_lose(swapped):
    cases = choose_cases(swapped, "usac", rescued=1, lost=100, success_px=10.0)
    lost = {(case.group, case.pair_id): case.changed for case in cases if case.kind == "lost"}
    expected = {}
    pairs = swapped.tables.pairs[~swapped.tables.pairs["group"].isin(APART)]
    for pair in zip(pairs["group"], pairs["pair_id"], strict=True):
        counts = []
        for own in (True, False):
            found = [sides(swapped, pair, e, names[0] if own else "snn") for e, names in PHOTOGRAPH_INPUTS.items()]
            counts.append(sum(after < 0.5 < before for before, after in found))
        if max(counts):
            expected[pair] = max(counts)
    assert expected
    assert (lost, list(lost.values())) == (expected, sorted(lost.values(), reverse=True))


def test_a_rescued_pair_shows_an_accepted_run(photographs):
    (first, *_) = photographs.cases
    runs = photographs.results.tables.runs
    own = (runs["group"] == first.group) & (runs["pair_id"] == first.pair_id) & (runs["input"] == "default")
    results = changed(photographs, status=runs["status"].mask(own, "degenerate"))
    assert first.name not in {case.name for case in choose_cases(results, "usac", rescued=9, lost=1, success_px=10.0)}
