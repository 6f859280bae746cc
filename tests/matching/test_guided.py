"""Matches along epipolar lines: as the slow way finds them, and what they find that the whole image hides."""

import numpy as np
import pytest

from epiprior.features.describe import normalise_descriptors
from epiprior.geometry import normalise_fundamental, sampson_distance
from epiprior.matching.guided import MAX_ANGLE, MAX_DISTANCE_RATIO, _bands, guided_matches
from epiprior.types import Features
from synthetic import make_pair, skew

PX = 3.0


def features_at(xy, descriptors, size=(1024, 768)):
    n = len(xy)
    columns = {"scale": np.full(n, 2.0, np.float32), "orientation_deg": np.zeros(n, np.float32)}
    xy, descriptors = np.asarray(xy, np.float32), np.asarray(descriptors, np.float32)
    return Features(image_size=size, xy=xy, descriptors=descriptors, **columns)


def slowly(first, second, F, px):
    """Return the matches of all pairs of features, one by one."""
    d1, d2 = (normalise_descriptors(f.descriptors, root=True, centred=False) for f in (first, second))
    near = np.array([sampson_distance(F, np.tile(x, (len(second), 1)), second.xy) for x in first.xy]) < px
    angle = np.where(near, np.arccos(np.clip(d1 @ d2.T, -1, 1)), np.inf)

    def best(row, xy):
        j = int(np.argmin(row))
        elsewhere = row[(xy != xy[j]).any(axis=1)].min(initial=np.pi / 2)
        return j, row[j], row[j] / elsewhere

    found = {}
    for i in range(len(first)):
        j, nearest, ratio = best(angle[i], second.xy)
        if not np.isfinite(nearest):
            continue
        back, _, other = best(angle[:, j], first.xy)
        if (first.xy[back] == first.xy[i]).all() and nearest <= MAX_ANGLE and max(ratio, other) <= MAX_DISTANCE_RATIO:
            places = (int(np.flatnonzero((f.xy == f.xy[k]).all(axis=1))[0]) for f, k in ((first, i), (second, j)))
            name = tuple(places)
            found[name] = min(found.get(name, 1.0), max(ratio, other))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_matches_are_those_of_the_slow_way(seed):
    pair, rng = make_pair(inliers=120, outliers=80, noise_px=0.5, seed=seed), np.random.default_rng(seed)
    x1, x2 = pair.matches.x1, pair.matches.x2
    # A few descriptors, so that many look alike, and a third of the places twice.
    d1 = rng.uniform(0, 1, (15, 128))[rng.integers(0, 15, len(x1))] + rng.uniform(0, 0.4, (len(x1), 128))
    d2 = np.abs(d1 + rng.normal(0, 0.1, d1.shape))
    twins = rng.choice(len(x1), 60, replace=False)
    first = features_at(np.vstack([x1, x1[twins]]), np.vstack([d1, d1[twins] + rng.uniform(0, 0.3, (60, 128))]))
    second = features_at(np.vstack([x2, x2[twins]]), np.vstack([d2, d2[twins] + rng.uniform(0, 0.3, (60, 128))]))
    found = guided_matches(first, second, pair.F, threshold_px=PX, factors=(1.0, 1.0))
    expected = slowly(first, second, pair.F, PX)
    assert sorted(tuple(row) for row in found.tolist()) == sorted(expected)
    assert len(expected) > 30
    ratios = [expected[tuple(row)] for row in found.tolist()]
    assert (np.diff(ratios) > -1e-4).all()


@pytest.mark.parametrize(
    "epipole", [(-4000.0, 300.0), (500.0, 9000.0), (1400.0, 380.0), (512.0, 384.0), "on a feature"]
)
def test_bands_hold_all_that_is_near_a_line(epipole):
    rng = np.random.default_rng(0)
    x1, x2 = (rng.uniform((0, 0), (1024, 768), (n, 2)) for n in (150, 400))
    at = x2[0] if epipole == "on a feature" else np.array(epipole)
    H = np.array([[1.02, 0.03, 20.0], [-0.02, 0.97, -15.0], [2e-5, -1e-5, 1.0]])
    F = normalise_fundamental(skew([*at, 1.0]) @ H)
    order, first, last = _bands(F, x1, x2, PX**2)
    widths = last - first
    for i, x in enumerate(x1):
        band = order[first[i] : last[i]].tolist()
        assert len(set(band)) == len(band)
        assert set(np.flatnonzero(sampson_distance(F, np.tile(x, (400, 1)), x2) < PX).tolist()) <= set(band)
    if max(np.abs(at)) > 2000:
        assert widths.mean() < 0.05 * 400


def test_what_repeats_in_the_image_does_not_repeat_on_the_line():
    pair, rng = make_pair(inliers=100, outliers=0, noise_px=0.0), np.random.default_rng(0)
    x1, x2 = pair.matches.x1, pair.matches.x2
    same = np.repeat(rng.uniform(0, 1, (10, 128)), 10, axis=0)
    first, second = features_at(x1, same), features_at(x2, same)
    found = guided_matches(first, second, pair.F, threshold_px=1.0, factors=(1.0, 1.0))
    assert len(found) > 50
    assert (found[:, 0] == found[:, 1]).mean() > 0.9
    # In images of other sizes, F and places in their pixels: the same.
    S1, S2 = np.diag([0.5, 0.5, 1.0]), np.diag([0.25, 0.25, 1.0])
    large = guided_matches(
        features_at(2 * x1, same), features_at(4 * x2, same), S2 @ pair.F @ S1, threshold_px=1.0, factors=(2.0, 4.0)
    )
    np.testing.assert_array_equal(large, found)


def test_without_features_there_are_no_matches():
    none, some = features_at(np.empty((0, 2)), np.empty((0, 128))), features_at(np.ones((3, 2)), np.ones((3, 128)))
    for first, second in ((none, some), (some, none), (none, none)):
        found = guided_matches(first, second, make_pair().F, threshold_px=PX, factors=(1.0, 1.0))
        assert found.shape == (0, 2)
