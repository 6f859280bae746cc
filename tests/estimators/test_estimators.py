"""Every estimator on every kind of bad input, and the traps of their backends."""

import re
from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

import epiprior
from calls import refused
from epiprior.errors import EstimatorError, FeatureError, SettingsError
from epiprior.estimators import find_estimator, fit, licences, list_estimators, names, registry
from epiprior.geometry import sampson_distance
from epiprior.types import FundamentalEstimate, MatchSet, Status
from synthetic import cap, make_matches, make_pair, run

IN_ORDER = ("usac", "magsac++", "gc-ransac", "prosac")
BY_PROBABILITY = ("guided-mlesac", "beem", "blogs", "generalized-ransac")
WITHOUT_PRIOR = ("lo-ransac", "degensac", "colmap")
DETERMINISTIC = ("epiprior",)
KNOWN = {*IN_ORDER, *BY_PROBABILITY, *WITHOUT_PRIOR, *DETERMINISTIC}
AVAILABLE = [name for name, state in list_estimators().items() if state == "available"]
each_estimator = pytest.mark.parametrize("name", AVAILABLE)
each_random_estimator = pytest.mark.parametrize("name", [name for name in AVAILABLE if name not in DETERMINISTIC])


def assert_sound(estimate: FundamentalEstimate, matches: MatchSet, threshold_px: float = 1.5) -> None:
    """What epiprior promises of every estimate, whatever the backend returned."""
    assert estimate.inliers.shape == (len(matches),)
    assert estimate.support == estimate.inliers.sum()
    assert bool(estimate) == (estimate.status is Status.OK)
    assert estimate.F is not None or not estimate
    assert (estimate.message == "") == bool(estimate)
    assert estimate.version
    if estimate.F is None:
        assert estimate.H is not None or not estimate.inliers.any()
        return
    s = np.linalg.svd(estimate.F, compute_uv=False)
    assert s[2] < 1e-12 < s[1]
    assert np.linalg.norm(estimate.F) == pytest.approx(1.0, abs=1e-12)
    assert estimate.F.flat[np.abs(estimate.F).argmax()] > 0
    if estimate.H is None:  # else they are those of the homography
        assert np.array_equal(estimate.inliers, sampson_distance(estimate.F, matches.x1, matches.x2) < threshold_px)


def test_registry_names_states_and_licences_and_a_missing_backend_says_what_to_install(monkeypatch):
    assert set(names()) == KNOWN
    assert tuple(list_estimators()) == tuple(licences()) == names()
    assert epiprior.list_estimators() == list_estimators()
    assert list_estimators()["usac"] == "available"
    assert all(licences().values())
    monkeypatch.setattr("epiprior.estimators.protocol.importlib.util.find_spec", lambda _: None)
    assert list_estimators()["degensac"] == 'pip install "epiprior[degensac]"'
    for name, state in list_estimators().items():
        if state != "available":
            assert state.startswith("pip install")
            refused(EstimatorError, re.escape(f"{name} is not installed: {state}"), run, name, STILL)


@pytest.mark.skipif(find_spec("sklearn") is None, reason="the extra lab, which brings all backends, is not installed")
def test_none_is_missing_where_the_extra_lab_is_installed():
    """Both locks install it; a missing backend would drop its tests from this file without a word."""
    assert set(AVAILABLE) == KNOWN


@each_estimator
def test_easy_pair(name):
    pair = make_pair(inliers=200, outliers=100)
    estimate = run(name, pair.matches)
    assert_sound(estimate, pair.matches)
    assert estimate.status is Status.OK
    assert pair.error_px(estimate.F) < 0.6
    assert estimate.inliers[pair.right].mean() > 0.95 > 0.05 > estimate.inliers[~pair.right].mean()


@each_estimator
def test_five_percent_inliers_in_a_good_order(name):
    """Those that take no prior get the head of the order, the others all."""
    pair = make_pair(inliers=40, outliers=760, order=3.5, seed=3)
    matches = pair.matches.take(slice(80)) if name in WITHOUT_PRIOR else pair.matches
    estimate = run(name, matches)
    assert_sound(estimate, matches)
    assert pair.error_px(estimate.F) < 2.0


@pytest.mark.parametrize("name", IN_ORDER)
def test_the_order_is_the_prior_that_is_used(name, monkeypatch):
    pair = make_pair(inliers=40, outliers=760, order=3.5, seed=3)
    shuffled = pair.matches.take(np.random.default_rng(0).permutation(800))
    cap(monkeypatch, name, 2_000)
    assert not pair.error_px(run(name, shuffled).F) < 10


@pytest.mark.parametrize("name", BY_PROBABILITY)
def test_the_probability_is_the_prior_that_is_used(name, monkeypatch):
    """The order says nothing to these, equal probabilities are no help; nor are orientations at random."""
    pair = make_pair(inliers=40, outliers=760, order=3.5, seed=3)
    rng = np.random.default_rng(0)
    shuffled = pair.matches.take(rng.permutation(800))
    shuffled = replace(shuffled, orientation2_deg=rng.uniform(0, 360, len(shuffled)))
    assert pair.error_px(run(name, shuffled).F) < 2.0
    equal = replace(shuffled, probability=np.full(len(shuffled), 0.05))
    cap(monkeypatch, name, 1_000)
    assert not pair.error_px(run(name, equal).F) < 10


UNDECIDED, TOO_FEW = (Status.DEGENERATE, Status.NO_MODEL), (Status.TOO_FEW_MATCHES,)
STILL = make_pair(inliers=100, outliers=0).matches
ROW_17 = (np.arange(100) == 17)[:, None]
POOR = {
    "no inliers": (make_pair(inliers=0, outliers=100).matches, (Status.NO_MODEL,)),
    "collinear points": (make_pair(scene="line", inliers=100, outliers=0).matches, UNDECIDED),
    "identical images": (make_matches(STILL.x1, STILL.x1), UNDECIDED),
    "plane": (make_pair(scene="plane", inliers=150, outliers=60, seed=2).matches, UNDECIDED),
    "rotation": (make_pair(scene="rotation", inliers=150, outliers=60, seed=2).matches, UNDECIDED),
    "eight matches": (make_pair(inliers=8, outliers=0, noise_px=0.01, seed=4).matches, (Status.OK, Status.NO_MODEL)),
    "nothing": (STILL.take(slice(0)), TOO_FEW),
    "seven matches": (STILL.take(slice(7)), TOO_FEW),
    "one match fifty times": (STILL.take(np.zeros(50, np.int64)), TOO_FEW),
    "fifty matches of one point": (make_matches(np.tile(STILL.x1[:1], (50, 1)), STILL.x2[:50]), TOO_FEW),
}


@pytest.mark.parametrize("kind", POOR)
@each_estimator
def test_what_decides_nothing_is_told(name, kind):
    matches, statuses = POOR[kind]
    estimate = run(name, matches)
    assert_sound(estimate, matches)
    assert estimate.status in statuses
    if estimate.status is Status.DEGENERATE:
        assert "F is not determined" in estimate.message or "does not move with the scene" in estimate.message
    if kind in ("nothing", "seven matches"):
        assert f"{len(matches)} distinct matches" in estimate.message


@each_estimator
def test_repeated_matches_change_nothing_but_the_mask_and_the_same_seed_gives_the_same_bytes(name):
    pair = make_pair(inliers=60, outliers=40)
    twice = pair.matches.take(np.repeat(np.arange(100), 2))
    once, estimate = run(name, pair.matches), run(name, twice)
    assert_sound(estimate, twice)
    assert once.F is not None
    assert np.array_equal(once.F, estimate.F)
    assert estimate.support == 2 * once.support
    # Of a large seed; a deterministic estimator gives the same with any.
    matches = make_pair(inliers=60, outliers=140, order=2.0).matches
    seed = 2**63 + 12345
    one, again = (run(name, matches, seed=k) for k in (seed, seed + (name in DETERMINISTIC)))
    assert (one.F.tobytes(), one.inliers.tobytes()) == (again.F.tobytes(), again.inliers.tobytes())


@each_random_estimator
def test_another_seed_draws_otherwise(name, monkeypatch):
    """On noisy matches with many near-best models: seeds that did nothing would all give one F."""
    matches = make_pair(inliers=80, outliers=80, noise_px=2.0, order=0.5, seed=1).matches
    cap(monkeypatch, name, 200)
    found = {F.tobytes() for seed in range(8) if (F := fit(name, matches, seed=seed).F) is not None}
    assert len(found) > 1


def test_opencv_error_is_no_model(monkeypatch):
    def throw(*_):
        raise cv2.error("assertion failed")

    monkeypatch.setattr(cv2, "findFundamentalMat", throw)
    assert run("usac", make_pair().matches).status is Status.NO_MODEL


def pair_in_order(**how):
    """A pair whose images do not change places, so that a backend may answer with its F."""
    pairs = (make_pair(seed=seed, **how) for seed in range(20))
    return next(pair for pair in pairs if pair.matches.x1[0, 0] < pair.matches.x2[0, 0])


def backend_answers(monkeypatch, name, F):
    """Let the backend of an estimator return `F`, beside a mask that is garbage."""
    garbage = np.full((300, 1), 205, np.uint8)
    if name in ("usac", "magsac++", "gc-ransac"):
        monkeypatch.setattr(cv2, "findFundamentalMat", lambda *_: (F, garbage))
    elif name in ("prosac", "lo-ransac"):
        poselib = pytest.importorskip("poselib")
        monkeypatch.setattr(poselib, "estimate_fundamental", lambda *_: (F, {"iterations": 3, "inliers": garbage}))
    elif name == "degensac":
        monkeypatch.setattr(pytest.importorskip("pydegensac"), "findFundamentalMatrix", lambda *_, **__: (F, garbage))
    elif name == "colmap":
        pycolmap = pytest.importorskip("pycolmap")
        answer = None if F is None else {"F": F, "inlier_mask": garbage}
        monkeypatch.setattr(pycolmap, "estimate_fundamental_matrix", lambda *_: answer)
    else:
        monkeypatch.setitem(registry._REGISTRY, name, replace(find_estimator(name), run=lambda *_: (F, None)))


@each_estimator
def test_no_matrix_of_any_backend_is_taken_for_a_model_and_no_mask_is_looked_at(monkeypatch, name):
    matches = make_pair().matches
    nothing = [None] if name in ("usac", "magsac++", "gc-ransac", "colmap") else []
    of_other_rank = (np.diag([1.0, 0.0, 0.0]), np.diag([1, 1, np.inf]))
    for F in (np.full((3, 3), np.nan), np.zeros((3, 3)), np.ones((9, 3)), *of_other_rank, *nothing):
        backend_answers(monkeypatch, name, F)
        estimate = run(name, matches)
        assert_sound(estimate, matches)
        assert estimate.status is Status.NO_MODEL
        assert F is None or "rank 2" in estimate.message
    pair = pair_in_order()
    backend_answers(monkeypatch, name, pair.F)
    estimate = run(name, pair.matches)
    assert_sound(estimate, pair.matches)
    assert estimate.status is Status.OK
    assert estimate.inliers[~pair.right].mean() < 0.05


def test_the_matrix_of_a_backend_is_mended_and_judged(monkeypatch):
    for how, change, status in (
        ({}, lambda F: -5 * (F + 1e-9 * np.eye(3)), Status.OK),  # brought to rank two
        ({"inliers": 7, "outliers": 30}, lambda F: F, Status.NO_MODEL),  # seven right matches have no say
    ):
        pair = pair_in_order(**how)
        answer = change(pair.F), 3
        backend = replace(find_estimator("usac"), run=lambda *_, answer=answer: answer)
        monkeypatch.setitem(registry._REGISTRY, "usac", backend)
        estimate = run("usac", pair.matches)
        assert_sound(estimate, pair.matches)
        assert (estimate.status, estimate.iterations) == (status, 3)


@pytest.mark.parametrize("name", [name for name in ("prosac", "lo-ransac") if name in AVAILABLE])
def test_poselib_keeps_its_cap(name, monkeypatch):
    noise = make_pair(inliers=0, outliers=200).matches
    assert fit(name, noise).iterations == 5_000
    cap(monkeypatch, name, 50)
    assert fit(name, noise).iterations <= 51


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"name": "usak"}, EstimatorError, r"'usak', known: usac, "),
        *(({"seed": seed}, SettingsError, f"seed is {seed}") for seed in (-1, 1.5)),
        ({"x2": STILL.x2[:-1]}, FeatureError, "x1 holds 100 points and x2 99"),
        *(({"x2": np.where(ROW_17, value, STILL.x2)}, FeatureError, r"x2 .* row 17") for value in (np.nan, np.inf)),
    ],
    ids=range(6),
)
@pytest.mark.parametrize("name", ["usac", "epiprior"])
def test_bad_input_is_refused(name, change, error, message):
    how = {"name": name, "seed": 0, "x2": STILL.x2} | change
    refused(error, message, run, how["name"], make_matches(STILL.x1, how["x2"]), seed=how["seed"])
