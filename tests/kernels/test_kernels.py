"""Every kernel of the estimators against a slow, plain twin."""

from itertools import combinations

import numpy as np
import pytest

import naive
from epiprior.estimators.own import condition
from epiprior.kernels import algebra, local_steps, samples, sampson, scores, solvers
from epiprior.verification.degeneracy import fit_homography, homography_distance
from synthetic import make_pair, same_matrix

MASK = (1 << 64) - 1


def conditioned(**options):
    pair = make_pair(**options)
    c = condition(pair.matches)
    return pair, c, c.columns


def from_pixels(c, F):
    """Return F of pixels, shape (3, 3) or (K, 3, 3), for conditioned coordinates, at unit norm: undoes `to_pixels`."""
    u = c.unit_px
    S1, S2 = (np.array([[u, 0, centre[0]], [0, u, centre[1]], [0, 0, 1]]) for centre in (c.centre1, c.centre2))
    G = S2.T @ F @ S1
    return np.ascontiguousarray(G / np.linalg.norm(G, axis=(-2, -1), keepdims=True))


def splitmix(state):
    state = (state + 0x9E3779B97F4A7C15) & MASK
    z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    z ^= z >> 31
    return state, (z >> 11) / 2**53


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 2])
def test_generator_is_splitmix64_and_draws_equal_a_walk_along_the_sums(seed):
    state, expected = seed, []
    for _ in range(50):
        state, value = splitmix(state)
        expected.append(value)
    kernel = samples.generator_state(seed)
    assert [samples.next_uniform(kernel) for _ in range(50)] == expected
    cumulative = samples.cumulated(np.random.default_rng(0).uniform(size=37) * (np.arange(37) % 3 > 0))
    state, twin = samples.generator_state(9), 9
    for _ in range(200):
        twin, u = splitmix(twin)
        i, left = 0, u * cumulative[-1]
        while cumulative[i] <= left:
            i += 1
        assert samples.draw(cumulative, state) == i


def test_samples_hold_no_two_close_matches_have_a_head_and_a_tail_or_are_refused():
    _, _, columns = conditioned(inliers=60, outliers=20)
    columns[:, 1::2] = columns[:, ::2] + 1e-4  # every second match is a near copy
    cumulative = samples.cumulated(np.ones(80))
    state, sample = samples.generator_state(0), np.zeros(7, np.int64)
    for _ in range(200):
        assert samples.fill_sample(cumulative, cumulative, 7, 7, state, columns, 0.01**2, sample)
        for i, j in combinations(sample, 2):
            assert np.hypot(*(columns[:2, i] - columns[:2, j])) > 0.01
            assert np.hypot(*(columns[2:, i] - columns[2:, j])) > 0.01
    _, _, columns = conditioned(inliers=60, outliers=0)
    head, tail = samples.cumulated((np.arange(60) < 20) * 1.0), samples.cumulated((np.arange(60) >= 20) * 1.0)
    assert samples.fill_sample(head, tail, 5, 7, state, columns, 0.0, sample)
    assert (sample < 20).tolist() == [True] * 5 + [False] * 2
    assert not samples.fill_sample(head, np.zeros(60), 5, 7, state, columns, 0.0, sample)
    for weights in (np.arange(1.0, 31.0), np.zeros(30)):
        assert not samples.fill_sample(weights, weights, 7, 7, state, np.zeros((4, 30)), 0.0, sample)


def naive_seven_point(x1, x2):
    A = np.array([np.outer(np.append(b, 1), np.append(a, 1)).ravel() for a, b in zip(x1, x2, strict=True)])
    G, H = np.linalg.svd(A)[2][-2:].reshape(2, 3, 3)
    at = np.array([-1.0, 0.0, 1.0, 2.0])
    roots = np.roots(np.polyfit(at, [np.linalg.det(G + t * H) for t in at], 3))
    return [G + t.real * H for t in roots if abs(t.imag) < 1e-7]


def test_seven_points():
    models = np.zeros((3, 3, 3))
    rng = np.random.default_rng(1)
    for trial in range(100):
        _, _, columns = conditioned(inliers=40, outliers=0, seed=trial)
        sample = rng.choice(40, 7, replace=False)
        count = solvers.seven_point(columns, sample, models)
        expected = naive_seven_point(columns[:2, sample].T, columns[2:, sample].T)
        assert count == len(expected)
        for F in models[:count]:
            assert any(same_matrix(F, E, 1e-5) for E in expected)
            assert abs(np.linalg.det(F)) < 1e-9
    assert solvers.seven_point(np.repeat(np.array([[0.1], [0.2], [0.3], [0.4]]), 7, axis=1), np.arange(7), models) == 0
    assert algebra.real_roots(1.0, 2.0, 3.0, 0.0, np.empty(3)) == 0  # no cubic, no roots


def test_epipoles_and_the_closest_matrix_of_rank_two():
    rng = np.random.default_rng(0)
    right, left = np.empty(3), np.empty(3)
    for _ in range(50):
        F = rng.normal(size=(3, 2)) @ rng.normal(size=(2, 3))
        algebra.epipoles(F, right, left)
        assert np.abs([F @ right, left @ F]).max() < 1e-12
        assert np.linalg.norm(right) == pytest.approx(np.linalg.norm(left)) == pytest.approx(1)
    algebra.epipoles(np.diag([1.0, 0, 0]), right, left)
    assert not np.any([right, left])
    for _ in range(30):
        U, _, Vt = np.linalg.svd(rng.normal(size=(3, 3)))
        F = U @ np.diag([1.0, 0.7, rng.uniform(0, 0.2)]) @ Vt
        algebra.make_rank_two(F)
        assert same_matrix(F, U @ np.diag([1.0, 0.7, 0.0]) @ Vt)


@pytest.mark.parametrize("seed", range(3))
def test_weighted_eight_points(seed):
    _, _, columns = conditioned(inliers=50, outliers=0, seed=seed)
    weights = np.random.default_rng(seed).uniform(0.1, 1, 50)
    weights[::5] = 0
    F = np.zeros((3, 3))
    assert solvers.weighted_eight_point(columns, weights, F)
    assert same_matrix(F, naive.eight_point(columns[:2].T, columns[2:].T, weights), 1e-8)
    assert np.linalg.svd(F, compute_uv=False)[2] < 1e-12
    # Whole weights are as good as repeated matches.
    counts = np.arange(50) % 3
    assert solvers.weighted_eight_point(columns, counts.astype(float), F)
    repeated = np.repeat(columns, counts, axis=1)
    assert same_matrix(F, naive.eight_point(repeated[:2].T, repeated[2:].T))
    # What decides nothing is refused.
    _, _, columns = conditioned(inliers=40, outliers=10)
    F = np.zeros((3, 3))
    assert not solvers.weighted_eight_point(columns, (np.arange(50) < 7) * 1.0, F)
    assert not solvers.weighted_eight_point(np.repeat(columns[:, :1], 20, axis=1), np.ones(20), F)
    assert not F.any()


def test_samples_of_eight_points_and_two_oriented_matches_are_eight_points():
    _, _, columns = conditioned(inliers=40, outliers=0, noise_px=0.0)
    rows = np.argsort(np.random.default_rng(0).random((20, 40)), axis=1)[:, :8]
    for F, row in zip(solvers.fit_samples(columns, rows), rows, strict=True):
        assert max(naive.sampson(F, columns[:2, i], columns[2:, i]) for i in row) < 1e-6
        assert same_matrix(F, naive.eight_point(columns[:2, row].T, columns[2:, row].T), 1e-4)
    _, _, columns = conditioned(inliers=40, outliers=10)
    rng = np.random.default_rng(3)
    frames = np.concatenate([rng.uniform(0.01, 0.05, (2, 50)), rng.uniform(0, 6, (2, 50))])
    F = np.zeros((3, 3))
    assert solvers.two_oriented(columns, frames, 4, 31, 6.0, F)
    sides = []
    for side in range(2):
        points = []
        for m in (4, 31):
            centre = columns[2 * side : 2 * side + 2, m]
            points.append(centre)
            for k in range(3):
                angle = frames[2 + side, m] + k * 2 * np.pi / 3
                points.append(centre + 6 * frames[side, m] * np.array([np.cos(angle), np.sin(angle)]))
        sides.append(np.array(points))
    assert same_matrix(F, naive.eight_point(*sides), 1e-5)


def test_same_side_equals_its_definition():
    models = np.zeros((3, 3, 3))
    rng = np.random.default_rng(0)
    seen = set()
    for trial in range(60):
        _, _, columns = conditioned(inliers=20, outliers=20, seed=trial)
        sample = rng.choice(40, 7, replace=False)
        for F in models[: solvers.seven_point(columns, sample, models)]:
            left = np.linalg.svd(F)[0][:, 2]
            a, b = (np.column_stack([columns[k : k + 2, sample].T, np.ones(7)]) for k in (0, 2))
            sides = (np.cross(left, b) * (a @ F.T)).sum(axis=1)
            assert samples.same_side(F, columns, sample) == (abs(np.sign(sides).sum()) == 7)
            seen.add(samples.same_side(F, columns, sample))
    assert seen == {True, False}


@pytest.mark.parametrize("off", [0, 1, 2])
def test_samples_of_a_plane(off):
    pair, c, columns = conditioned(scene="plane+", inliers=80, outliers=0, noise_px=0.0, off_plane=30)
    F, x1, x2 = from_pixels(c, pair.F), pair.matches.x1, pair.matches.x2
    distance = homography_distance(fit_homography(x1, x2, 1.0), x1, x2)
    on, beside = np.flatnonzero(distance < 0.01), np.flatnonzero(distance > 10)
    assert len(on) == 50
    for trial in range(10):
        rng = np.random.default_rng(trial)
        parts = rng.choice(on, 7 - off, replace=False), rng.choice(beside, off, replace=False)
        sample = rng.permutation(np.concatenate(parts))
        assert samples.on_one_plane(F, columns, sample, (1.0 / c.unit_px) ** 2) == 7 - off


def naive_score(F, columns, gain, kind, sigma, limit):
    total = 0.0
    for i in range(columns.shape[1]):
        r = naive.sampson(F, columns[:2, i], columns[2:, i])
        if r < limit:
            if kind == scores.SUPPORT:
                total += gain[i] * (1 - (r / sigma) ** 2)
            elif kind == scores.KERNEL:
                total += gain[i] * np.exp(-((r / sigma) ** 2) / 2)
            else:
                total += np.log(1 + gain[i] * np.exp(-((r / sigma) ** 2) / 2))
    return total


@pytest.mark.parametrize("kind", [scores.SUPPORT, scores.LIKELIHOOD, scores.KERNEL])
def test_scores(kind):
    pair, c, columns = conditioned(inliers=150, outliers=150)
    F, sigma = from_pixels(c, pair.F), 1.0 / c.unit_px
    gain = pair.matches.probability * (50 if kind == scores.LIKELIHOOD else 1)
    rest, limit = scores.attainable(gain, kind), scores.cut_distance(kind, sigma)
    work = np.empty((2, scores.BLOCK))
    value = scores.score(F, columns, gain, rest, kind, sigma, limit, 0.0, work)
    assert value == pytest.approx(naive_score(F, columns, gain, kind, sigma, limit), rel=1e-9)
    assert scores.score(F, columns, gain, rest, kind, sigma, limit, value * (1 - 1e-12), work) == value
    assert scores.score(F, columns, gain, rest, kind, sigma, limit, value, work) <= value
    other = scores.score(np.eye(3), columns, gain, rest, kind, sigma, limit, -np.inf, work)
    assert other == pytest.approx(naive_score(np.eye(3), columns, gain, kind, sigma, limit), rel=1e-9)


def test_bail_out_changes_no_winner():
    pair, c, columns = conditioned(inliers=100, outliers=900, order=1.0)
    rng = np.random.default_rng(0)
    models = from_pixels(c, pair.F) + rng.normal(0, 1, (200, 3, 3)) * rng.choice([0.001, 0.01, 0.1], (200, 1, 1))
    gain, sigma = pair.matches.probability, 1.5 / c.unit_px
    rest, work = scores.attainable(gain, scores.SUPPORT), np.empty((2, scores.BLOCK))
    whole = [scores.score(F, columns, gain, rest, scores.SUPPORT, sigma, sigma, -np.inf, work) for F in models]
    best, winner = 0.0, -1
    for k, F in enumerate(models):
        value = scores.score(F, columns, gain, rest, scores.SUPPORT, sigma, sigma, best, work)
        if value > best:
            best, winner = value, k
    assert (winner, best) == (np.argmax(whole), max(whole))


def test_likelihood_is_that_of_the_mixture():
    """Differences of the score are differences of sum log(v p_in(r) + (1 - v) / w)."""
    validity, sigma, width = np.array([0.9, 0.2, 0.5]), 0.7, 300.0
    odds = scores.likelihood_odds(validity, sigma, width)
    for r in (0.0, 0.5, 2.0):
        inlier = np.sqrt(2 / np.pi) / sigma * np.exp(-((r / sigma) ** 2) / 2)
        mixture = np.log(validity * inlier + (1 - validity) / width)
        relative = np.log1p(odds * np.exp(-((r / sigma) ** 2) / 2))
        np.testing.assert_allclose(relative, mixture - np.log((1 - validity) / width), rtol=1e-12)


def test_squared_distances_and_weights_of_the_next_fit():
    pair, c, columns = conditioned()
    F, limit = from_pixels(c, pair.F), 3 / c.unit_px
    out, scratch = np.empty(300), np.empty(300)
    sampson.squared_distances(F, columns, out, scratch)
    expected = [naive.sampson(F, columns[:2, i], columns[2:, i]) ** 2 for i in range(300)]
    np.testing.assert_allclose(out, expected, rtol=1e-9)
    sampson.squared_distances(np.zeros((3, 3)), columns, out, scratch)
    assert np.isinf(out).all()
    gain, weights = pair.matches.probability, np.empty(300)
    sampson.tukey_weights(F, columns, gain, limit**2, weights, np.empty(300))
    for i in range(300):
        a, b = np.append(columns[:2, i], 1), np.append(columns[2:, i], 1)
        g = ((F @ a)[:2] ** 2).sum() + ((F.T @ b)[:2] ** 2).sum()
        r = naive.sampson(F, columns[:2, i], columns[2:, i])
        expected = gain[i] * (1 - (r / limit) ** 2) ** 2 / g if r < limit else 0.0
        assert weights[i] == pytest.approx(expected, rel=1e-9)


def test_local_optimisation_improves_and_never_harms():
    pair, c, columns = conditioned(inliers=200, outliers=200, seed=2)
    gain, sigma = np.ones(400), 1.5 / c.unit_px
    limits = scores.SUPPORT, sigma, sigma
    rest, work = scores.attainable(gain, scores.SUPPORT), np.empty((2, scores.BLOCK))
    models = np.zeros((3, 3, 3))
    rng = np.random.default_rng(0)
    better = 0
    for trial in range(10):
        sample = rng.choice(np.flatnonzero(pair.right), 7, replace=False)
        for F in models[: solvers.seven_point(columns, sample, models)]:
            before = scores.score(F, columns, gain, rest, *limits, -np.inf, work)
            state = samples.generator_state(trial)
            value = local_steps.optimise(F, columns, gain, gain, rest, *limits, 4 * sigma, 5, state)
            assert value == scores.score(F, columns, gain, rest, *limits, -np.inf, work) >= before
            better += pair.error_px(c.to_pixels(F)) < 1.0
    assert better >= 8


def test_joint_feature_density():
    pair, c, columns = conditioned(inliers=100, outliers=100)
    F, limit = from_pixels(c, pair.F), 1.5 / c.unit_px
    gain, out = pair.matches.probability, np.empty(200)
    assert local_steps.joint_feature_weights(F, columns, gain, limit, out)
    t = np.array([np.outer(np.append(columns[2:, i], 1), np.append(columns[:2, i], 1)).ravel() for i in range(200)])
    near = np.array([naive.sampson(F, columns[:2, i], columns[2:, i]) < limit for i in range(200)])
    scatter = (t[near].T * gain[near]) @ t[near] / gain[near].sum() + limit**2 * np.eye(9)
    q = np.array([row @ np.linalg.solve(scatter, row) for row in t])
    np.testing.assert_allclose(out, np.exp(-0.5 * np.maximum(q - 9, 0)), rtol=1e-6, atol=1e-12)
    assert out[pair.right].mean() > 5 * out[~pair.right].mean()
    assert not local_steps.joint_feature_weights(F, columns, np.zeros(200), limit, out)


def test_conditioning_goes_there_and_back():
    pair, c, columns = conditioned()
    F = from_pixels(c, pair.F)
    assert same_matrix(c.to_pixels(F), pair.F, 1e-12)
    assert from_pixels(c, np.stack([pair.F, pair.F])).shape == (2, 3, 3)
    pixels = [naive.sampson(pair.F, a, b) for a, b in zip(pair.matches.x1, pair.matches.x2, strict=True)]
    units = [naive.sampson(F, columns[:2, i], columns[2:, i]) for i in range(300)]
    np.testing.assert_allclose(np.array(units) * c.unit_px, pixels, rtol=1e-8)
    assert np.linalg.norm(F) == pytest.approx(1)
