"""Pairs of every kind: planned without doubles, made alike every time, estimated with what is known of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from epiprior.estimators.handover import HandOver
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation.kinds import COLMAP, KindCase, case_records, places_of, plan_cases
from epiprior_lab.labels.ground_truth import TRUTH
from epiprior_lab.scenes.kinds import KINDS, make_views
from pictures import texture


def pair(scene, number):
    name = f"{scene}{number}"
    return SimpleNamespace(pair_id=name, scene=scene, image1=f"{name}a", image2=f"{name}b")


SETS = {"x": [pair("p", 0), pair("p", 1), pair("q", 0)], "y": [pair("r", 0)]}


def test_pairs_of_places_are_planned_once_and_the_same_every_time():
    assert {name: len(pairs) for name, pairs in places_of(SETS, by_scene=True).items()} == {"p": 2, "q": 1, "r": 1}
    assert {name: len(pairs) for name, pairs in places_of(SETS, by_scene=False).items()} == {"x": 3, "y": 1}
    places = places_of(SETS, by_scene=True)
    counts = {"pair": 9, "unrelated": 12, "copy": 5, "doppelganger": 2}
    planned, again = (plan_cases(places, counts, block="b", seed=3) for _ in range(2))
    assert planned == again
    by_kind = {kind: [case for case in planned if case.kind == kind] for kind in ("pair", "unrelated", "copy")}
    assert len(by_kind["pair"]) == len({case.pair.pair_id for case in by_kind["pair"]}) == 4  # there are no more
    assert len({frozenset(case.images) for case in by_kind["unrelated"]}) == 12
    assert all(first[0] != second[0] for first, second in (case.images for case in by_kind["unrelated"]))
    assert all(first == second for first, second in (case.images for case in by_kind["copy"]))
    assert len({case.seed for case in planned}) == len({case.name for case in planned}) == len(planned)


@pytest.mark.parametrize("kind", KINDS)
def test_views_are_made_of_what_the_kind_says(kind):
    pictures = [np.repeat(texture(320, 240, seed)[:, :, None], 3, axis=2) for seed in (1, 2)]
    for picture in pictures:
        picture.flags.writeable = False  # letters are written into copies, also where no other size is needed
    views, second = (make_views(kind, tuple(pictures), seed=5) for _ in range(2))
    for mine, again in zip(views, second, strict=True):
        assert mine.dtype == np.uint8
        np.testing.assert_array_equal(mine, again)
    if kind in ("unrelated", "copy"):
        np.testing.assert_array_equal(views[0], pictures[0])
    if kind == "overlay":
        assert all(0.001 < np.mean(view != given) < 0.7 for view, given in zip(views, pictures, strict=True))
    if kind in ("plane", "rotation"):
        assert views[0].shape == views[1].shape == (600, 800, 3)
        assert np.mean(views[0] == views[1]) < 0.5


@pytest.mark.filterwarnings("ignore:create.. is deprecated:DeprecationWarning")  # of pycolmap 4.2
def test_a_true_pair_has_an_error_and_no_other_kind(pairs, tiny_model):
    how = {"inputs": {"magsac++": ("snn", "default")}, "truth": TRUTH, "rule": CascadeRule()}
    how |= {"hand_overs": {"magsac++": dict.fromkeys(("snn", "default"), HandOver())}, "cascaded": ["magsac++"]}
    true = KindCase(name="t", block="b", kind="pair", seed=0, pair=pairs[0])
    copy = KindCase(name="c", block="b", kind="copy", seed=0, images=(pairs[0].image1, pairs[0].image1))
    found = {case.kind: case_records(case=case, group="g", **how) for case in (true, copy)}
    rows = [("magsac++", "snn"), ("magsac++", "default"), ("magsac++", "cascade"), (COLMAP, "snn")]
    assert all([(r.estimator, r.input) for r in records] == rows for records in found.values())
    assert found["pair"][0].error_px < 3
    assert replace(found["pair"][2], input="snn") == found["pair"][0]
    assert all(np.isnan(record.error_px) for record in found["copy"])
    assert (found["copy"][0].status, found["copy"][0].geometry) == ("degenerate", "identical")
    assert case_records(case=true, group="g", **how)[-1] == found["pair"][-1]  # COLMAP's draws have a seed
