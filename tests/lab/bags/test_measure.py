"""A bag is filled, mapped and judged: by true cameras, and on views whose cameras are known."""

import itertools
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bags_fakes import PARAMS, camera
from epiprior.collection.model import Model
from epiprior_lab.bags.choose import PLAIN, Bag, View
from epiprior_lab.bags.measure import judge, measure_bag
from epiprior_lab.pairsets import read_pair_set
from synthetic import rotation

NAMES = [f"0{k}.jpg" for k in range(5)]
MAPPER = PARAMS.mapper


def photographed(places="aaaaa"):
    turns = [rotation((0.2, 1, 0), 8 * k) for k in range(len(places))]
    return {
        name: View(image=Path(name), camera=camera(k**1.5, R=R), place=place)
        for k, (name, place, R) in enumerate(zip(NAMES, places, turns, strict=True))
    }


def model_of(named, seen=NAMES, turned=()):
    """Return the true model in a frame of its own; cameras of `turned` look elsewhere."""
    turn, scale, shift = rotation((1, 2, 3), 70), 3.7, np.array([5.0, -2, 1])
    away = rotation((0, 1, 0), 25)
    cameras = [named[name].camera for name in seen]
    wrong = [away if name in turned else np.eye(3) for name in seen]
    rotations = np.array([w @ c.R @ turn.T for w, c in zip(wrong, cameras, strict=True)])
    centres = np.array([scale * turn @ c.centre + shift for c in cameras])
    about = {"points": np.zeros((0, 3)), "colours": np.zeros((0, 3), np.uint8), "tracks": Counter({2: 30, 5: 10})}
    about |= {"folder": Path(), "seen": dict.fromkeys(seen, 10), "error_px": 0.5}
    return Model(rotations=rotations, centres=centres, **about)


def test_the_true_model_is_right_in_any_frame_what_is_not_registered_or_looks_elsewhere_is_not():
    found = judge(model_of(photographed()), photographed(), MAPPER)
    assert found["accuracy"] == pytest.approx(1.0)
    counts = {"images": 5, "registered": 5, "wrong": 0, "others": 0, "strangers": 0, "tracks": 40}
    assert {name: found[name] for name in counts} == counts
    assert found["track_length"] == pytest.approx(2.75)
    found = judge(model_of(photographed(), NAMES[:3]), photographed(), MAPPER)
    assert (found["registered"], found["wrong"]) == (3, 0)
    assert found["accuracy"] == pytest.approx(3 / 10)
    nothing = judge(None, photographed(), MAPPER)
    assert (nothing["registered"], nothing["accuracy"], nothing["tracks"]) == (0, 0.0, 0)
    assert np.isnan(nothing["track_length"])
    found = judge(model_of(photographed(), turned=NAMES[:1]), photographed(), MAPPER)
    assert (found["registered"], found["wrong"]) == (5, 1)
    assert found["accuracy"] == pytest.approx(6 / 10)


@pytest.mark.parametrize(
    ("places", "seen", "home"),
    [
        ("aaaab", NAMES, (4, 4, 1, 1)),
        ("aaaab", NAMES[:4], (4, 4, 1, 0)),
        ("aaaab", NAMES[3:], (4, 1, 1, 1)),  # one of each: the bag's home decides
        ("aaabb", NAMES[2:], (2, 2, 3, 1)),
        ("aaabb", [], (3, 0, 2, 0)),
    ],
)
def test_strangers_are_those_of_another_place_than_most(places, seen, home):
    named = photographed(places)
    found = judge(model_of(named, seen) if seen else None, named, MAPPER)
    assert tuple(found[name] for name in ("images", "registered", "others", "strangers")) == home


def true_matches(count):
    """Return what a learned matcher would find: the same points in all pairs, numbered by itself."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-3, 6, 400), rng.uniform(-2, 2, 400), rng.uniform(7, 20, 400)])
    seen = [(camera(k).project(points)[0], rng.permutation(900)[:400]) for k in range(count)]
    found = []
    for (x1, n1), (x2, n2) in itertools.combinations(seen, 2):
        both = [((x >= 0) & (x < (480, 300))).all(axis=1) for x in (x1, x2)]
        rows = rng.permutation(np.flatnonzero(both[0] & both[1]))
        found.append({"x1": x1[rows], "x2": x2[rows], "feature1": n1[rows], "feature2": n2[rows]})
    return found


@pytest.mark.slow
@pytest.mark.parametrize("method", ["colmap", "snn", "cascade", "aliked"])
def test_every_method_maps_views_whose_cameras_are_known(side_by_side, method):
    pytest.importorskip("pycolmap")
    images = sorted({image for pair in read_pair_set(side_by_side).pairs for image in (pair.image1, pair.image2)})
    views = tuple(View(image=image, camera=camera(k), place="wall") for k, image in enumerate(images))
    bag = Bag(group="side", scene="wall", kind=PLAIN, size=len(views), number=0, views=views)
    own = {"learned": true_matches(len(views)), "learned_s": 100.0} if method == "aliked" else {}
    records = measure_bag(bag=bag, method=method, mapper=MAPPER, **own)
    assert [record.intrinsics for record in records] == ["known", "inferred"]
    for record in records:
        assert (record.bag, record.method, record.images) == (bag.name, method, len(views))
        assert (record.registered, record.wrong, record.strangers) == (len(views), 0, 0)
        assert record.tracks > 100
        assert 2 < record.track_length <= len(views)
        assert (record.matching_s > 100) == (method == "aliked")
        assert np.isnan(record.features_s) == (method == "aliked")
    assert records[0].accuracy > 0.9
    again = measure_bag(bag=bag, method=method, mapper=MAPPER, **own)
    timeless = {"features_s": 0.0, "matching_s": 0.0, "mapping_s": 0.0}
    assert [replace(r, **timeless) for r in again] == [replace(r, **timeless) for r in records]
