"""The estimators of our own loop: what their parts are for, and the priors they sample by."""

from dataclasses import replace

import numpy as np
import pytest

from epiprior.estimators import find_estimator, fit, own, ratio_prior
from epiprior.estimators.own import Recipe, search, similarity_prior
from epiprior.geometry import sampson_distance
from epiprior.kernels.scores import KERNEL, LIKELIHOOD, SUPPORT
from epiprior.types import MatchSet, Status
from synthetic import HEIGHT, SyntheticPair, cap, make_matches, make_pair, same_matrix

OWN = ("guided-mlesac", "beem", "blogs", "generalized-ransac")


def found(matches, prior, most, **recipe):
    """The F of a recipe that samples by a prior."""
    return search(Recipe(prior=lambda _: prior, **recipe), matches, 1.5, most, 0)[0]


def quarter_turn(x):
    return np.column_stack([HEIGHT - 1 - x[:, 1], x[:, 0]])


def two_motions(first, second, probability):
    """Matches of both, of which the second make a quarter turn."""
    x2 = np.concatenate([first.x2, quarter_turn(second.x2)])
    return make_matches(np.concatenate([first.x1, second.x1]), x2, probability)


def with_frames(pair: SyntheticPair, turn_deg: int) -> MatchSet:
    """Give right matches scales and orientations that agree, as a detector would; image 2 turns by 0 or 90 degrees."""
    rng = np.random.default_rng(0)
    n = len(pair.matches)
    scale, angle = rng.uniform(2, 8, n), rng.uniform(0, 360, n)
    scale2 = np.where(pair.right, scale * np.exp(rng.normal(0, 0.08, n)), rng.uniform(2, 8, n))
    angle2 = np.where(pair.right, angle + rng.normal(0, 4, n), rng.uniform(0, 360, n))
    x2 = quarter_turn(pair.matches.x2) if turn_deg else pair.matches.x2
    columns = {"scale1": scale, "scale2": scale2, "orientation1_deg": angle}
    return replace(pair.matches, x2=x2, orientation2_deg=np.mod(angle2 + turn_deg, 360), **columns)


def inliers_found(F, matches, right) -> float:
    return float((sampson_distance(F, matches.x1, matches.x2) < 2)[right].mean())


@pytest.mark.parametrize("turn_deg", [0, 90])
def test_two_oriented_matches_find_what_seven_do_not(turn_deg):
    """Ten per cent inliers and no prior: the chance is 1/100 for two matches, 1/10,000,000 for seven."""
    pair = make_pair(inliers=60, outliers=540, seed=1)
    matches = with_frames(pair, turn_deg)
    how = {"kind": SUPPORT, "raw_factor": 3.0}
    oriented, seven = (found(matches, np.full(600, 0.1), 5_000, oriented=share, **how) for share in (1.0, 0.0))
    assert inliers_found(oriented, matches, pair.right) > 0.8
    assert inliers_found(seven, matches, pair.right) < 0.7


def test_supporters_joined_with_others_lead_off_a_plane_and_beem_finds_f_beside_one():
    close = np.zeros(2)
    for seed in range(6):
        pair = make_pair(scene="plane+", inliers=200, outliers=600, off_plane=30, order=0.5, seed=seed)
        for k, share in enumerate((0.0, 0.5)):
            how = {"kind": SUPPORT, "local": 1, "local_share": 0.5, "mixed_share": share, "min_iterations": 1_500}
            close[k] += pair.error_px(found(pair.matches, np.full(800, 0.5), 1_500, **how)) < 3
    assert close[1] > close[0]
    assert close[1] >= 5
    # Its own recipe. What its mixed samples add is too little to be tested: its other samples find F as well.
    how = {"scene": "plane+", "inliers": 200, "outliers": 300, "off_plane": 30, "order": 0.5, "noise_px": 0.2}
    pairs = [make_pair(**how, seed=seed) for seed in range(6)]
    assert sum(pair.error_px(fit("beem", pair.matches).F) < 3 for pair in pairs) >= 5


@pytest.mark.parametrize(("scene", "changes"), [("plane", True), ("relief", False)])
def test_samples_of_one_plane_are_ruled_out(scene, changes):
    """On a plane nothing else is left: what is ruled out comes back as the last resort, and is judged later.

    Then the best sample alone is optimised, where otherwise each is that beats those before it: another F. Where no
    sample lies on one plane, ruling out changes nothing.
    """
    matches = make_pair(scene=scene, inliers=150, outliers=0, noise_px=0.1, seed=2).matches
    kept, ruled_out = (found(matches, np.ones(150), 300, kind=KERNEL, skip_planes=skip) for skip in (False, True))
    assert same_matrix(kept, ruled_out, 1e-6) is not changes


@pytest.mark.parametrize("name", OWN)
def test_the_cap_is_kept_and_easy_pairs_end_early(name, monkeypatch):
    noise = replace(make_pair(inliers=0, outliers=200).matches, probability=np.full(200, 0.05))
    assert name == "blogs" or fit(name, make_pair(inliers=200, outliers=20).matches).iterations < 500
    monkeypatch.setattr(own, "CONFIDENCE", 1 - 1e-12)
    assert fit(name, noise).iterations == find_estimator(name).max_iterations <= 5_000
    cap(monkeypatch, name, 50)
    assert fit(name, noise).iterations == 50


@pytest.mark.parametrize("name", OWN)
def test_distance_ratios_stand_in_for_probabilities_and_everything_improbable_changes_no_f(name):
    pair = make_pair(inliers=150, outliers=150)
    ratio = np.where(pair.right, 0.6, 0.88) + np.random.default_rng(0).normal(0, 0.05, 300)
    matches = replace(pair.matches, probability=np.full(300, np.nan), distance_ratio=np.clip(ratio, 0, 0.9))
    assert pair.error_px(fit(name, matches).F) < 1
    # Twice as many matches of another motion, all of probability 0, lead F nowhere; alone they raise nothing.
    pair, other = make_pair(inliers=100, outliers=20), make_pair(inliers=200, outliers=0, seed=1).matches
    m = pair.matches
    both = two_motions(m, other, np.concatenate([m.probability, np.zeros(200)]))
    assert pair.error_px(fit(name, both).F) < 0.6
    assert fit(name, replace(m, probability=np.zeros(120))).status in (Status.OK, Status.NO_MODEL)


def test_the_likelihood_trusts_probable_matches():
    """Two motions: the more numerous one loses where its matches are improbable."""
    first, second = (make_pair(inliers=n, outliers=0, seed=s).matches for n, s in ((60, 0), (100, 1)))
    matches = two_motions(first, second, np.repeat([0.9, 0.02], [60, 100]))
    F = found(matches, matches.probability, 3_000, kind=LIKELIHOOD, min_iterations=3_000)
    assert inliers_found(F, matches, np.arange(160) < 60) > 0.9


def test_blogs_prefers_probabilities_then_similarity_then_ratio():
    matches = make_pair().matches
    assert np.array_equal(similarity_prior(matches), matches.probability)
    standard = replace(matches, probability=np.full(300, np.nan), similarity_weight=np.linspace(0, 0.02, 300))
    np.testing.assert_allclose(similarity_prior(standard), np.linspace(0, 1, 300))
    neither = replace(standard, similarity_weight=np.zeros(300))
    assert np.array_equal(similarity_prior(neither), ratio_prior.inlier_probability(matches.distance_ratio))


def test_density_and_the_tables_are_densities():
    np.testing.assert_allclose(ratio_prior.density(np.random.default_rng(0).uniform(0, 1, 20_000)), 1.0, atol=0.1)
    few = np.array([0.02, 0.5])
    grid = np.linspace(0, 1, 26)
    said = [[sum(np.exp(-0.5 * ((g - m) / 0.03) ** 2) for m in (d, -d, 2 - d)) for d in few] for g in grid]
    np.testing.assert_allclose(ratio_prior.density(few), np.mean(said, axis=1) / (0.03 * np.sqrt(2 * np.pi)))
    for table in (ratio_prior.DENSITY_IN, ratio_prior.DENSITY_OUT):
        assert np.trapezoid(table, grid) == pytest.approx(1, abs=0.03)
        assert (table > 0).all()
    assert ratio_prior.inlier_probability(np.empty(0)).shape == (0,)
    for ratio in (0.0, 0.5, 1.0):
        equal = ratio_prior.inlier_probability(np.full(20, ratio))
        assert np.isfinite(equal).all()
        assert np.ptp(equal) == 0


@pytest.mark.parametrize("share", [0.1, 0.4, 0.8])
@pytest.mark.parametrize("cut", [0.85, 1.0])
def test_the_share_of_right_matches_is_fitted_to_the_pair(share, cut):
    """Ratios drawn from the tables themselves, cut as matches are: their mean probability is the share drawn."""
    rng = np.random.default_rng(0)
    fine = np.linspace(0, cut, 2_000)
    parts = []
    for table, n in ((ratio_prior.DENSITY_IN, share), (ratio_prior.DENSITY_OUT, 1 - share)):
        f = np.interp(fine, np.linspace(0, 1, 26), table)
        parts.append(rng.choice(fine, round(4_000 * n), p=f / f.sum()))
    probability = ratio_prior.inlier_probability(np.concatenate(parts))
    right = np.arange(4_000) < len(parts[0])
    assert probability.mean() == pytest.approx(share, abs=0.05)
    assert probability[right].mean() > probability[~right].mean() + 0.1
    low, high = probability < 0.3, probability > 0.7
    for part in (low, high):  # calibrated
        if part.sum() > 200:
            assert right[part].mean() == pytest.approx(probability[part].mean(), abs=0.08)
