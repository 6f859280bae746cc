"""Bags grow over pairs that overlap; a stranger comes from another set."""

from dataclasses import replace
from pathlib import Path

import pytest

from bags_fakes import PARAMS, chain
from epiprior_lab.bags.choose import STRANGER, difficulty, plain_bags, stranger_bags


def linked(bag, pairs):
    """Whether all photographs of a bag hang together over the pairs."""
    own = {view.image for view in bag.views}
    edges = [{p.image1, p.image2} for p in pairs if {p.image1, p.image2} <= own]
    reached = {bag.views[0].image}
    for _ in own:
        reached = reached.union(*(edge for edge in edges if edge & reached))
    return reached == own


def test_bags_hang_together_and_differ_and_a_stranger_is_of_another_set():
    sets = {"long": chain("long", 9), "short": chain("short", 3)}
    bags = plain_bags(sets, PARAMS.bags)
    assert {(bag.group, bag.size) for bag in bags} == {("long", 3), ("long", 5), ("short", 3)}  # none of 5 in three
    assert len({bag.name for bag in bags}) == len(bags)
    for bag in bags:
        assert len({view.image for view in bag.views}) == len(bag.named) == bag.size
        assert linked(bag, sets[bag.group])
        assert {view.place for view in bag.views} == {f"{bag.group}/row"}
    long = [tuple(v.image for v in bag.views) for bag in bags if (bag.group, bag.size) == ("long", 3)]
    assert len(set(long)) == len(long) == 2
    alone = plain_bags({"long": sets["long"]}, PARAMS.bags)
    assert [bag.name for bag in alone] == [bag.name for bag in bags if bag.group == "long"]
    assert [v.image for v in alone[0].views] == [v.image for v in bags[0].views]
    found = stranger_bags(bags, sets, PARAMS.bags)
    assert [(bag.group, bag.kind, bag.size, len(bag.views)) for bag in found] == [("long", STRANGER, 5, 6)]
    assert sorted(view.place for view in found[0].views) == ["long/row"] * 5 + ["short/row"]
    assert stranger_bags(bags, {"long": sets["long"]}, PARAMS.bags) == []


def test_a_small_part_of_a_scene_gives_no_bag_and_hides_none():
    """Growing begins anew where the part of the first photograph is too small."""
    pairs = chain("x", 2) + chain("x", 5, first=10)
    assert 5 in [bag.size for bag in plain_bags({"x": pairs}, PARAMS.bags)]
    assert plain_bags({"x": [replace(pair, camera1=None, camera2=None) for pair in pairs]}, PARAMS.bags) == []


@pytest.mark.parametrize("case", [([0.1, 0.1, 0.9], "hard"), ([0.1, 0.4, 0.9], "medium"), ([0.6], "easy"), ([], "")])
def test_difficulty_is_the_median_over_the_pairs_of_the_bag(case):
    values, level = case
    pairs = chain("x", 9)
    bag = next(bag for bag in plain_bags({"x": pairs}, PARAMS.bags) if bag.size == 5)
    own = {view.image for view in bag.views}
    inside = [(p.image2, p.image1) for p in pairs if {p.image1, p.image2} <= own]  # the order does not matter
    shares = dict(zip(inside, values, strict=False)) | {(Path("other"), Path("another")): 1.0}
    assert difficulty(bag, shares, easy=0.5, hard=0.2) == level
