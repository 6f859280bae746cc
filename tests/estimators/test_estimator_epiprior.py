"""The estimator ``epiprior``: what it uses of the prior, what it mends, what it refuses, and its kernels."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest

from epiprior.estimators.epiprior import models_of_plane, oriented_pairs, plane_and_parallax, progressive_rows
from epiprior.geometry import Evidence, as_columns, normalise_fundamental, sampson_distance
from epiprior.kernels.local_steps import climb, refine_models
from epiprior.kernels.samples import generator_state
from epiprior.types import FloatArray, Status
from epiprior.verification.measures import SpreadEvidence, camera_plausibility, match_weights
from naive import eight_point, sampson
from synthetic import make_matches, make_pair, on_epipolar_lines, project, rotation, run, same_matrix


def perturbed(F: FloatArray, count: int, size: float, seed: int = 0) -> FloatArray:
    models: FloatArray = F * (1 + size * np.random.default_rng(seed).normal(size=(count, 3, 3)))
    return models / np.linalg.norm(models, axis=(1, 2), keepdims=True)


# The kernels and their naive twins.


def naive_score(F, x1, x2, weights, group, threshold):
    """What the best match of each group says."""
    said = dict.fromkeys(group, 0.0)
    for g, a, b, w in zip(group, x1, x2, weights, strict=True):
        said[g] = max(said[g], w * (1 - (sampson(F, a, b) / threshold) ** 2))
    return sum(said.values())


@pytest.mark.parametrize("size", [1, 3])
def test_scores_are_those_of_the_naive_twin_and_models_that_are_none_score_nothing(size):
    pair = make_pair(inliers=60, outliers=60)
    m = pair.matches
    group = np.random.default_rng(0).permutation(120) // size
    models = perturbed(pair.F, 150, 0.02)
    found = Evidence(m.x1, m.x2, m.probability, group).scores(models, 3.0)
    wanted = [naive_score(F, m.x1, m.x2, m.probability, group, 3.0) for F in models[::10]]
    assert found[::10] == pytest.approx(wanted, abs=0.01, rel=1e-3)
    assert found.max() > 5
    m = make_pair(inliers=20, outliers=0).matches
    evidence = Evidence(m.x1, m.x2, m.probability, np.arange(20))
    assert not evidence.scores(np.stack([np.zeros((3, 3)), np.full((3, 3), np.nan)]), 2.0).any()
    assert evidence.scores(np.empty((0, 3, 3)), 2.0).shape == (0,)
    assert not Evidence(m.x1[:0], m.x2[:0], m.probability[:0], m.feature1[:0]).scores(np.ones((2, 3, 3)), 2.0).any()


def test_probability_weighs_a_crowd_speaks_once_and_clusters_and_implausible_cameras_less():
    pair = make_pair(inliers=50, outliers=0, noise_px=0.0)
    m = replace(pair.matches, probability=np.full(50, 0.5))
    crowd = m.take(np.zeros(30, np.int64))
    crowd = replace(crowd, feature1=np.arange(30), feature2=np.arange(30))

    def said(matches):
        return SpreadEvidence(matches).scores(pair.F[None])[0]

    alone = said(m.take(slice(1)))
    assert said(crowd) == pytest.approx(alone, rel=1e-4)
    for sizes in (((1024, 768), (1024, 768)), ((1024, 768), (102400, 76800))):
        wanted = camera_plausibility(pair.F[None], sizes)[0] * said(m)
        assert said(replace(m, image_sizes=sizes)) == pytest.approx(wanted)
    assert wanted < said(m)
    m = make_matches(np.zeros((4, 2)), np.zeros((4, 2)), distance_ratio=np.array([0.8, 0.8, 0.8, 1.0]))
    low, middle, high, cluster = match_weights(m, np.array([0.0, 0.5, 1.0, 0.5]))
    assert low == 0 < middle < high < np.inf
    assert cluster == pytest.approx(middle / 2)


def naive_refinement(F, x1, x2, weights, thresholds):
    for threshold in thresholds:
        fit = np.zeros(len(x1))
        for i, (a, b) in enumerate(zip(x1, x2, strict=True)):
            l2, l1 = F @ np.append(a, 1), F.T @ np.append(b, 1)
            rest = max(1 - (sampson(F, a, b) / threshold) ** 2, 0)
            fit[i] = weights[i] * rest**2 / (l2[0] ** 2 + l2[1] ** 2 + l1[0] ** 2 + l1[1] ** 2)
        F = eight_point(x1, x2, fit)
    return F


def test_refinement_is_that_of_the_naive_twin():
    pair = make_pair(inliers=80, outliers=80)
    m = pair.matches
    start = perturbed(pair.F, 4, 0.01)
    thresholds = (8.0, 4.0, 2.0)
    refined = start.copy()
    refine_models(refined, as_columns(m.x1, m.x2), m.probability, np.array(thresholds))
    for before, after in zip(start, refined, strict=True):
        assert same_matrix(after, naive_refinement(before, m.x1, m.x2, m.probability, thresholds), 1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_climbing_returns_the_score_of_what_it_returns_and_never_less(seed):
    pair = make_pair(inliers=80, outliers=80, seed=seed)
    m = pair.matches
    group = np.sort(np.random.default_rng(seed).integers(0, 60, 160))
    start = perturbed(pair.F, 1, 0.03, seed)[0]
    thresholds = np.array([3.0, 2.0, 1.5, 1.5])
    args = (as_columns(m.x1, m.x2), m.probability, m.probability, group)
    scores, errors = [], []
    for samples in (0, 30):
        F = start.copy()
        scores.append(climb(F, *args, 2.0, thresholds, 3.0, samples, generator_state(1)))
        errors.append(pair.error_px(normalise_fundamental(F)))
        assert scores[-1] == pytest.approx(naive_score(F, m.x1, m.x2, m.probability, group, 2.0), rel=1e-6)
    assert naive_score(start, m.x1, m.x2, m.probability, group, 2.0) <= scores[0] <= scores[1]
    assert errors[1] < 0.5 < pair.error_px(normalise_fundamental(start))


@pytest.mark.parametrize("n", [8, 9, 50, 1000])
def test_progressive_samples_grow_from_the_head(n):
    rows = progressive_rows(n, 300)
    assert all(len(set(row)) == 8 for row in rows)
    assert 0 == rows.min() <= rows.max() < n
    assert rows[:10].max() < 20
    if n == 1000:
        assert rows[-50:].mean() > 300


def test_two_oriented_matches_give_f():
    """Matches whose frames are those of a similarity between the images: all of them fit one F."""
    x1 = np.random.default_rng(0).uniform(0, [1024, 768], (12, 2))
    turn, zoom = np.deg2rad(30.0), 1.3
    R = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    frames = {"scale2": np.full(12, 3.0 * zoom), "orientation2_deg": np.full(12, 30.0)}
    matches = make_matches(x1, x1 @ R.T + [200.0, -100.0], **frames)
    models = oriented_pairs(matches, 10, 30.0)
    assert 0 < len(models) <= 45
    assert np.median([sampson_distance(F, matches.x1, matches.x2)[:2].min() for F in models]) < 1e-3


# Plane and parallax.


def test_models_of_a_plane_go_through_their_two_matches_and_mend_it_by_parallax():
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.uniform(-3, 3, 30), rng.uniform(-2, 2, 30), np.full(30, 10.0)])
    X[:5, 2] -= rng.uniform(1, 3, 5)
    R = rotation((0.1, 1.0, 0.05), 10.0)
    x1, x2 = project(X, np.eye(3), np.zeros(3)), project(X, R, np.array([-2.0, 0.2, 0.1]))
    models = models_of_plane(cv2.findHomography(x1[5:], x2[5:])[0], x1[:5], x2[:5])
    assert len(models) == 10
    for F, (i, j) in zip(models, combinations(range(5), 2), strict=True):
        assert sampson_distance(F, x1, x2).max() < 0.1, (i, j)
        assert np.linalg.svd(F, compute_uv=False)[2] < 1e-9
    # From an F that has the plane but a wrong epipole to the true one.
    pair = make_pair(scene="plane+", inliers=200, outliers=60, off_plane=25, order=4.0, seed=2)
    m = pair.matches
    flat = make_pair(scene="plane", inliers=200, outliers=0, seed=2).matches
    H = cv2.findHomography(flat.x1, flat.x2)[0]
    start = models_of_plane(H, np.array([[5.0, 700.0], [900.0, 20.0]]), np.array([[500.0, 5.0], [90.0, 760.0]]))[0]
    assert pair.error_px(normalise_fundamental(start)) > 10
    models = plane_and_parallax(start, m.x1, m.x2, threshold_px=1.5, plane_px=4.0, count=40)
    assert min(pair.error_px(F) for F in models) < 3
    pair = make_pair(inliers=100, outliers=0)
    m = pair.matches
    assert not len(plane_and_parallax(pair.F, m.x1, m.x2, threshold_px=1.5, plane_px=4.0, count=20))


# The estimator.


@pytest.mark.parametrize("seed", range(3))
def test_a_dominant_plane_is_mended(seed):
    pair = make_pair(scene="plane+", inliers=300, outliers=100, off_plane=30, order=3.0, seed=seed)
    assert pair.error_px(run("epiprior", pair.matches).F) < 2.0


@pytest.mark.parametrize("seed", range(3))
def test_rough_matrices_replace_samples(seed):
    """200 wrong matches of the highest probability lead every sample astray; one rough F is near the truth."""
    pair = make_pair(inliers=60, outliers=400, order=1.0, seed=seed)
    rough = np.concatenate([np.random.default_rng(seed).normal(size=(200, 3, 3)), perturbed(pair.F, 5, 0.003, seed)])
    without = pair.error_px(run("epiprior", pair.matches).F)
    with_rough = pair.error_px(run("epiprior", replace(pair.matches, rough_matrices=rough)).F)
    assert with_rough < 2.0
    assert with_rough <= without + 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_crowd_in_one_corner_does_not_outvote_the_image(seed):
    """One corner with 80 matches of another motion against 60 matches all over the image."""
    pair = make_pair(inliers=60, outliers=60, order=3.0, seed=seed)
    other = make_pair(inliers=2000, outliers=0, noise_px=0.3, seed=seed + 50)
    corner = np.flatnonzero((other.matches.x1 < [200, 180]).all(axis=1))[:80]
    x1 = np.concatenate([other.matches.x1[corner], pair.matches.x1])
    x2 = np.concatenate([other.matches.x2[corner][:, ::-1] * [1.2, 0.7], pair.matches.x2])
    probability = np.concatenate([np.full(len(corner), 0.6), np.clip(pair.matches.probability, 0.02, 0.6)])
    assert pair.error_px(run("epiprior", make_matches(x1, x2, probability)).F) < 3.0


def test_candidates_of_a_feature_count_once():
    """Ten candidates of each of 25 features, all on a wrong F: 25 voices, not 250."""
    pair, other = (make_pair(inliers=n, outliers=0, seed=s) for n, s in ((60, 1), (25, 2)))
    wrong1 = np.repeat(other.matches.x1, 10, axis=0)
    wrong2 = on_epipolar_lines(other.F, wrong1)
    x1, x2 = np.concatenate([wrong1, pair.matches.x1]), np.concatenate([wrong2, pair.matches.x2])
    feature1 = np.concatenate([np.repeat(np.arange(25), 10), 100 + np.arange(60)])
    assert pair.error_px(run("epiprior", make_matches(x1, x2, np.full(310, 0.5), feature1=feature1)).F) < 2.0


@pytest.mark.parametrize("seed", range(3))
def test_standard_matches_without_probabilities_some_of_which_share_a_point(seed):
    """Features of several scales at one location: eight of the best matches decide nothing."""
    pair = make_pair(inliers=80, outliers=120, order=2.0, seed=seed)
    x1 = np.vstack([np.repeat(pair.matches.x1[:1], 20, axis=0), pair.matches.x1])
    estimate = run("epiprior", make_matches(x1, np.vstack([pair.matches.x2[:20], pair.matches.x2])))
    assert estimate.status is Status.OK
    assert pair.error_px(estimate.F) < 1.0
