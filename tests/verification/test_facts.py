"""Facts of an estimate: each is what it says, none depends on the order of the images, all are finite."""

from dataclasses import replace

import numpy as np
import pytest

from epiprior.estimators import fit
from epiprior.types import MatchSet
from epiprior.verification.facts import COLUMNS, UNKNOWN
from synthetic import HEIGHT, WIDTH, make_pair
from synthetic_facts import facts_of

SIZES = ((float(WIDTH), float(HEIGHT)), (float(WIDTH), float(HEIGHT)))


def noisy_features(matches: MatchSet, right) -> MatchSet:
    """Features of right matches turn and grow alike, of the others at random."""
    rng = np.random.default_rng(0)
    n, base = len(matches), rng.uniform(0, 360, len(matches))
    turn = np.where(right, rng.normal(20, 8, n), rng.uniform(0, 360, n))
    scale = rng.uniform(1, 8, n)
    grown = scale * np.exp(np.where(right, rng.normal(0.3, 0.1, n), rng.normal(0, 1, n)))
    columns = {"orientation1_deg": base, "orientation2_deg": (base + turn) % 360, "scale1": scale, "scale2": grown}
    return replace(matches, **columns, image_sizes=SIZES)


def test_right_and_wrong_f_look_different_and_points_that_are_shared_count_once():
    pair, noise = make_pair(), make_pair(inliers=0, outliers=300, seed=4)
    right = facts_of(pair.F, noisy_features(pair.matches, pair.right))
    made_of_noise = fit("epiprior", noise.matches).F
    assert made_of_noise is not None
    wrong = facts_of(made_of_noise, noisy_features(noise.matches, noise.right))
    assert right.support == pytest.approx(np.log1p(200), abs=0.1)
    assert right.share > 0.6 > 0.1 > wrong.share
    assert right.by_chance < -50 < -10 < wrong.by_chance
    assert right.oriented == pytest.approx(1, abs=0.02)
    assert right.turn > 0.95 > 0.6 > wrong.turn
    assert right.scale < 0.2 < wrong.scale
    assert right.plausibility > 0.95
    assert right.explained_share > 0.9 > 0.6 > wrong.explained_share
    assert (right.known, right.rolls, right.rolls_agree, right.in_place, right.apart) == (1, 1, 1, 0, 1)
    # Every match twice, as where a picture holds every corner twice: no more distinct supporters.
    pair = make_pair(outliers=50)
    twice = pair.matches.take(np.repeat(np.arange(len(pair.matches)), 2))
    once, doubled = facts_of(pair.F, pair.matches), facts_of(pair.F, twice)
    for name in ("handed", "support", "share", "plane_support"):
        assert getattr(doubled, name) == pytest.approx(getattr(once, name), rel=0.05), name


@pytest.mark.parametrize("scene", ["relief", "plane", "rotation"])
def test_no_fact_depends_on_the_order_of_the_images(scene):
    pair = make_pair(scene=scene, outliers=60)
    matches = noisy_features(pair.matches, pair.right)
    one, other = facts_of(pair.F, matches), facts_of(pair.F.T, matches.swapped())
    for name in COLUMNS:
        # The best homography is fitted by samples, and residuals from it are measured in image 2.
        loose = name.startswith(("plane", "off", "parallax", "relief", "copy", "turn_like"))
        close = {"rel": 0.35, "abs": 0.25} if loose else {"rel": 0.05, "abs": 0.02}
        if name != "parallax_by_chance":
            assert getattr(one, name) == pytest.approx(getattr(other, name), **close), name


def test_what_is_unknown_is_said_to_be_and_other_rolls_agree_or_not_and_next_to_nothing_has_finite_facts():
    pair = make_pair()
    facts = facts_of(pair.F, replace(pair.matches, probability=np.full(len(pair.matches), np.nan)))
    assert (facts.turn, facts.scale, facts.plausibility, facts.probability, facts.turn_like) == (UNKNOWN,) * 5
    assert facts.known == 0
    other = make_pair(seed=8)
    assert facts_of(pair.F, pair.matches, others=(pair.F,)).rolls_agree == 1
    unlike = facts_of(pair.F, pair.matches, others=(other.F[::-1].copy(),))
    assert unlike.rolls == 2
    assert unlike.rolls_agree < 0.3
    for count in (0, 1, 8):
        row = facts_of(pair.F, pair.matches.take(slice(count))).row()
        assert (row.shape, row.dtype) == ((len(COLUMNS),), np.float32)
        assert np.isfinite(row).all()
