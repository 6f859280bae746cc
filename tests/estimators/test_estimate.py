"""From ranked matches to an estimate: hypotheses, hand-over, collection, refinement, working pixels."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calls import note_calls, refused
from epiprior.errors import SettingsError
from epiprior.estimators import fit as run_fit
from epiprior.estimators import run as running
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from epiprior.geometry import sampson_distance
from epiprior.types import FundamentalEstimate, Geometry, MatchSet, Status
from epiprior.verification.degeneracy import homography_distance
from synthetic import make_pair, run

PAPER = HandOver(one_to_one=True, top_k=300)
FULL = HandOver(one_to_one=True, top_k=300, collect=True, refine=True)


SIZES = ((1024.0, 768.0), (1024.0, 768.0))
HARD_PAIR = make_pair(inliers=150, outliers=1500)


def wrong_set() -> MatchSet:
    """A set with no right match, and probabilities that say so."""
    return replace(make_pair(inliers=0, outliers=300, seed=9).matches, probability=np.full(300, 0.01), roll_deg=90.0)


def usac(sets: MatchSet | list[MatchSet], how: HandOver, **options) -> FundamentalEstimate:
    sets = [sets] if isinstance(sets, MatchSet) else sets
    return estimate_from_matches(sets, estimator="usac", hand_over=how, **options)


def test_one_set_is_handed_over_as_it_is_and_the_other_order_gives_the_transposed_answer():
    pair = make_pair()
    estimate = estimate_from_matches([pair.matches], estimator="usac", seed=3, hand_over=HandOver())
    # The images are taken in the order that the matches decide.
    fits = (run_fit("usac", pair.matches, seed=3).F, run_fit("usac", pair.matches.swapped(), seed=3).F.T)
    assert any(np.array_equal(estimate.F, F) for F in fits)
    assert np.array_equal(estimate.x1, pair.matches.x1)
    assert estimate.support == np.count_nonzero(sampson_distance(estimate.F, estimate.x1, estimate.x2) < 1.5)
    assert set(estimate.seconds) == {"estimator", "support"}
    for scene in ("relief", "plane"):
        matches = replace(make_pair(scene=scene, seed=3).matches, image_sizes=SIZES, roll_deg=20.0)
        for name in ("usac", "epiprior", "blogs"):
            one, other = run(name, matches), run(name, matches.swapped())
            assert (one.status, one.geometry, one.confidence) == (other.status, other.geometry, other.confidence)
            assert np.array_equal(one.F, other.F.T)
            assert np.array_equal(one.inliers, other.inliers)
            assert (one.roll_deg, other.roll_deg) == (20.0, -20.0)


def test_confidence_is_known_of_every_F_and_decides_the_status():
    matches = replace(make_pair().matches, image_sizes=SIZES)
    sure = usac(matches, HandOver())
    assert (sure.geometry, sure.H) == (Geometry.GENERAL, None)
    assert sure.confidence > 0.5
    few = run("usac", matches.take(slice(5)))
    assert (few.status, few.F, few.geometry) == (Status.TOO_FEW_MATCHES, None, Geometry.NONE)
    assert math.isnan(few.confidence)
    assert usac(matches, HandOver(), min_confidence=sure.confidence).status is Status.OK
    doubted = usac(matches, HandOver(), min_confidence=min(1.0, sure.confidence + 1e-9))
    assert (doubted.status, doubted.geometry) == (Status.NO_MODEL, Geometry.NONE)
    assert "no more agreement than between photographs of different places" in doubted.message
    assert np.array_equal(doubted.F, sure.F)
    assert doubted.support == sure.support


@pytest.mark.parametrize("how", [PAPER, FULL], ids=["paper", "default"])
@pytest.mark.parametrize("first", [True, False])
def test_the_better_supported_roll_hypothesis_wins(how, first):
    sets = [replace(HARD_PAIR.matches, roll_deg=30.0), wrong_set()]
    estimate = usac(sets if first else sets[::-1], how)
    assert estimate.status is Status.OK
    assert estimate.roll_deg == 30.0
    assert HARD_PAIR.error_px(estimate.F) < 2.0


def test_probable_support_outweighs_numerous_support():
    """Set one: 60 probable matches of the true F. Set two: 150 improbable ones of another."""
    true, other = make_pair(inliers=60, outliers=0, seed=1), make_pair(inliers=150, outliers=0, seed=2)
    good = replace(true.matches, probability=np.full(60, 0.9), roll_deg=10.0)
    bad = replace(other.matches, x2=other.matches.x2[:, ::-1], probability=np.full(150, 0.05))
    by_count, by_probability = (usac([good, bad], how) for how in (PAPER, FULL))
    assert (by_count.roll_deg, by_probability.roll_deg) == (0.0, 10.0)


def test_support_is_collected_from_all_of_the_ranking_once_per_feature_of_probable_matches():
    pair = make_pair(inliers=600, outliers=300, order=3.0)
    narrow, wide = (usac(pair.matches, replace(how, top_k=100)) for how in (PAPER, FULL))
    assert len(narrow.x1) == 100
    assert wide.support > 500
    assert np.array_equal(wide.inliers, sampson_distance(wide.F, wide.x1, wide.x2) < 1.5)
    pair = make_pair(inliers=100, outliers=50)
    estimate = usac(pair.matches.take(np.repeat(np.arange(150), 3)), FULL)
    assert len(estimate.x1) <= 150
    assert len(np.unique(estimate.x1, axis=0)) == len(estimate.x1)
    pair = make_pair(inliers=200, outliers=2000, order=4.0)
    estimate = usac(pair.matches, FULL)
    truth = sampson_distance(pair.F, estimate.x1, estimate.x2) < 3.0
    assert estimate.support > 150
    assert len(estimate.x1) < 2000
    assert truth[estimate.inliers].mean() > 0.95


def test_refinement_on_probable_matches_helps():
    errors = []
    for seed in range(8):
        pair = make_pair(inliers=300, outliers=600, noise_px=0.8, order=3.0, seed=seed)
        found = [usac(pair.matches, replace(FULL, refine=refine, top_k=60)) for refine in (False, True)]
        bare = replace(pair.matches, probability=np.full(len(pair.matches), np.nan))
        found.append(usac(bare, HandOver(refine=True, collect=True)))
        errors.append([pair.error_px(estimate.F) for estimate in found])
    before, after, without_probabilities = np.median(errors, axis=0)
    assert after < 0.7 * before
    assert without_probabilities < 0.6


@pytest.mark.parametrize(
    ("matches", "status"),
    [
        (make_pair(inliers=7, outliers=0).matches, (Status.TOO_FEW_MATCHES,)),
        (wrong_set(), (Status.NO_MODEL,)),
        (make_pair(scene="plane", seed=2).matches, (Status.DEGENERATE, Status.NO_MODEL)),
        (make_pair(scene="rotation", seed=2).matches, (Status.DEGENERATE, Status.NO_MODEL)),
    ],
)
@pytest.mark.parametrize("how", [PAPER, FULL], ids=["paper", "default"])
def test_failure_is_a_status(matches, status, how):
    estimate = usac(matches, how)
    assert estimate.status in status
    assert (estimate.F is None) == (estimate.status is Status.TOO_FEW_MATCHES)
    assert estimate.message
    assert not estimate


def test_iterations_add_up_over_hypotheses_and_are_unknown_without_matches():
    m = make_pair().matches
    sets = ([m], [m, m], [m.take(slice(0))] * 2)
    one, two, none = (estimate_from_matches(each, estimator="prosac", hand_over=FULL) for each in sets)
    assert two.iterations == 2 * one.iterations
    assert (none.iterations, none.status) == (None, Status.TOO_FEW_MATCHES)


def test_a_plane_gives_its_homography_and_F_unless_something_stands_before_it():
    plane = replace(make_pair(scene="plane").matches, image_sizes=SIZES)
    estimate = run("usac", plane)
    assert (estimate.status, estimate.geometry) == (Status.DEGENERATE, Geometry.PLANAR)
    assert "one plane: F is not determined" in estimate.message
    assert np.linalg.norm(estimate.F) == pytest.approx(1.0)
    assert np.array_equal(estimate.inliers, homography_distance(estimate.H, plane.x1, plane.x2) < 4.0)
    scaled = replace(plane, x1=2 * plane.x1, x2=3 * plane.x2)
    H = usac(scaled, HandOver(), pixel_factors=(2.0, 3.0)).H
    assert homography_distance(H, scaled.x1, scaled.x2)[estimate.inliers].max() < 12.0
    matches = make_pair(scene="plane+", inliers=400, outliers=100, off_plane=60, seed=2).matches
    assert usac(matches, PAPER).status is Status.OK


def test_large_images_and_rough_matrices_are_measured_at_working_size(monkeypatch):
    """The same matches at four and two times the size, with thresholds of working pixels: the same answer."""
    pair = make_pair(noise_px=0.7)
    m = pair.matches
    large = replace(m, x1=m.x1 * 4, x2=m.x2 * 2)
    small = usac(m, FULL)
    scaled = usac(large, FULL, pixel_factors=(4.0, 2.0))
    assert np.array_equal(scaled.inliers, small.inliers)
    assert np.array_equal(scaled.x1, small.x1 * 4)
    D1, D2 = np.diag([4.0, 4.0, 1.0]), np.diag([2.0, 2.0, 1.0])
    back = D2 @ scaled.F @ D1
    assert np.abs(back / np.linalg.norm(back)) == pytest.approx(np.abs(small.F), abs=1e-12)
    assert usac(large, FULL).support < small.support
    # Half a pair's matches as given, in images of two and four times the working size, with F of given pixels.
    pair = make_pair(outliers=0)
    m = pair.matches
    given = np.linalg.inv(np.diag([4.0, 4.0, 1.0])).T @ pair.F @ np.linalg.inv(np.diag([2.0, 2.0, 1.0]))
    large = replace(m, x1=m.x1 * 2, x2=m.x2 * 4, rough_matrices=np.stack([given, 5 * given]))
    calls = note_calls(monkeypatch, running, "fit")
    usac(large, FULL, pixel_factors=(2.0, 4.0))
    _, seen = calls[0][0]
    wanted = sampson_distance(pair.F, m.x1, m.x2)
    for F in seen.rough_matrices:
        assert sampson_distance(F, seen.x1, seen.x2) == pytest.approx(wanted, rel=1e-6, abs=1e-9)
    assert seen.x1.max() in (pytest.approx(m.x1.max()), pytest.approx(m.x2.max()))


def test_the_hand_over_has_the_threshold_and_no_set_is_refused():
    estimate = usac(make_pair(noise_px=1.0).matches, replace(PAPER, threshold_px=0.5))
    assert np.array_equal(estimate.inliers, sampson_distance(estimate.F, estimate.x1, estimate.x2) < 0.5)
    refused(SettingsError, "no set", estimate_from_matches, [], estimator="usac", hand_over=PAPER)
