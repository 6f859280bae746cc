"""From matches to F: roll hypotheses, hand-over, refinement, support, confidence (paper, section 4.7).

The two images are always taken in one order, whichever they are given in, and the answer is turned back: it is then the
same, F transposed. Estimators draw samples and break ties by the order of numbers, so they would differ else.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from epiprior.errors import SettingsError
from epiprior.estimators.essential import WORTH, Intrinsics, essential_matrices
from epiprior.estimators.evidence import SpreadEvidence
from epiprior.estimators.handover import HandOver, hand_over
from epiprior.estimators.protocol import EstimatorSettings
from epiprior.estimators.registry import Fit, fit, with_checked_points
from epiprior.geometry import MIN_MATCHES, normalise_fundamental, refine_fundamental, sampson_distance
from epiprior.types import BoolArray, FloatArray, FundamentalEstimate, Geometry, MatchSet, Status
from epiprior.verification import degeneracy
from epiprior.verification.cascade import FLAT
from epiprior.verification.chance import chance_rate, distinct_count
from epiprior.verification.confidence import MESSAGES, Verdict, judge, load_confidence
from epiprior.verification.facts import Facts, chance_of_homography, describe_estimate

Factors = tuple[float, float]
_SURE_BY_CHANCE = -3.0  # of a homography without an F: expected once in a thousand pairs by chance,
_MOST = 0.5  # and most of the matches lie on it


class _Ready:
    """The matches of one roll hypothesis, in working pixels, with all that is the same for every estimate on them."""

    def __init__(self, matches: MatchSet, how: HandOver) -> None:
        self.matches, self.how, self.handed = matches, how, hand_over(matches, how)
        self.wide = self.evidence.single if how.collect else self.handed
        self.weights = np.nan_to_num(self.wide.probability, nan=1.0)

    @cached_property
    def evidence(self) -> SpreadEvidence:
        """What all matches say for an F."""
        return SpreadEvidence(self.matches)


@dataclass(frozen=True)
class ReadyMatches:
    """Matches that several estimates are made on; of `ready_matches`."""

    hypotheses: tuple[_Ready, ...]
    factors: Factors
    turned: bool
    seconds: float


@dataclass(frozen=True, kw_only=True)
class _Hypothesis:
    """The outcome of one roll hypothesis, in working pixels: F and what supports it."""

    found: Fit
    ready: _Ready
    collected: MatchSet
    F: FloatArray | None = None
    score: float = -1.0


@dataclass(frozen=True, kw_only=True)
class Described:
    """F in given pixels, None if there is none, and the facts that its confidence is learnt from."""

    F: FloatArray | None
    facts: Facts | None


def ready_matches(sets: Sequence[MatchSet], hand_over: HandOver, pixel_factors: Factors = (1.0, 1.0)) -> ReadyMatches:
    """Return what `estimate_from_matches` makes of its arguments first, to estimate more than once on them."""
    start = time.perf_counter()
    sets, factors, turned = _in_order(sets, pixel_factors)
    ready = tuple(_Ready(_scale(matches, 1 / factors[0], 1 / factors[1]), hand_over) for matches in sets)
    return ReadyMatches(ready, factors, turned, time.perf_counter() - start)


def estimate_from_matches(
    sets: Sequence[MatchSet] | ReadyMatches,
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    settings: EstimatorSettings | None = None,
    pixel_factors: Factors = (1.0, 1.0),
    min_confidence: float | None = None,
    intrinsics: tuple[Intrinsics, Intrinsics] | None = None,
) -> FundamentalEstimate:
    """Run an estimator on each of the sets, one per roll hypothesis, and return the best supported F.

    Each set is sorted best first; standard matches are a single set. Thresholds are meant in working pixels:
    `pixel_factors` are given pixels per working pixel in both images. `settings` replaces the estimator's own with the
    threshold of `hand_over`, and `min_confidence` the confidence from which on the status is ``ok``. Sets that
    `ready_matches` has made ready with this hand-over save time; their factors hold. `iterations` of the result adds up
    over the sets. Under known `intrinsics`, of the images in given pixels, `calibrated` of the result is the surer of
    `essential_matrices`, by the same facts. Raises what `epiprior.estimators.fit` and `load_confidence` raise, and
    SettingsError without any set.

    Paper: the F with more inliers wins. Ours, where `hand_over.collect`: what all matches of the set say for F decides,
    each weighted by its probability and each part of the images once, times the plausibility of the cameras
    (`epiprior.estimators.evidence`). A thousand improbable matches then weigh less than fifty good ones.
    """
    options = settings or EstimatorSettings(threshold_px=hand_over.threshold_px)
    ready = sets if isinstance(sets, ReadyMatches) else ready_matches(sets, hand_over, pixel_factors)
    start = time.perf_counter() - ready.seconds
    tried, best = _try_all(ready, estimator, seed, hand_over, options)
    answer = partial(_answer, tried, ready, options.threshold_px, min_confidence, estimator)
    estimate = answer(best)
    if intrinsics and estimate.confidence >= WORTH and estimate.geometry not in FLAT:
        estimate = replace(
            estimate, calibrated=_calibrated(answer, best, ready, intrinsics, options.threshold_px, seed)
        )
    running = sum(hypothesis.found.seconds for hypothesis in tried)
    estimate = replace(estimate, seconds={"estimator": running, "support": time.perf_counter() - start - running})
    return estimate.swapped() if ready.turned else estimate


def _answer(
    tried: Sequence[_Hypothesis],
    ready: ReadyMatches,
    px: float,
    min_confidence: float | None,
    estimator: str,
    best: _Hypothesis,
    E: FloatArray | None = None,
) -> FundamentalEstimate:
    """Return what is said of the best hypothesis, with the images in the order of `ready`."""
    collected = best.collected
    H, kind = _homography(best, px)
    if best.F is None:
        verdict = _without_fundamental(tried, best, kind)
    else:
        verdict = judge(_facts(tried, best, H, px), kind, load_confidence(), min_confidence)
    flat = verdict.geometry in FLAT
    inliers = np.zeros(len(collected), np.bool_)
    if flat and H is not None:
        inliers = _on_homography(H, collected, px)
    elif best.F is not None:
        inliers = sampson_distance(best.F, collected.x1, collected.x2) < px
    drawn = [hypothesis.found.iterations for hypothesis in tried]
    return FundamentalEstimate(
        status=verdict.status,
        F=None if best.F is None else _to_given_pixels(best.F, ready.factors),
        x1=collected.x1 * ready.factors[0],
        x2=collected.x2 * ready.factors[1],
        inliers=inliers,
        support=int(inliers.sum()),
        confidence=verdict.confidence,
        geometry=verdict.geometry,
        H=_homography_in_given_pixels(H, ready.factors) if flat and H is not None else None,
        E=E,
        iterations=sum(n for n in drawn if n is not None) if any(n is not None for n in drawn) else None,
        estimator=estimator,
        version=best.found.version,
        roll_deg=best.ready.matches.roll_deg,
        message=verdict.message,
    )


def _calibrated(
    answer: Callable[..., FundamentalEstimate],
    best: _Hypothesis,
    ready: ReadyMatches,
    intrinsics: tuple[Intrinsics, Intrinsics],
    px: float,
    seed: int,
) -> FundamentalEstimate | None:
    """Return the surest estimate from an essential matrix of the collected matches; None where there is none."""
    given = intrinsics[::-1] if ready.turned else intrinsics
    both = [camera.in_working_pixels(factor) for camera, factor in zip(given, ready.factors, strict=True)]
    straight, collected = best, best.collected
    if any(camera.undistort for camera in both):
        own = _undistorted(best.ready.matches, both)
        straight = replace(best, ready=_Ready(own, best.ready.how), collected=_undistorted(collected, both))
    x1, x2, K1, K2 = straight.collected.x1, straight.collected.x2, both[0].K, both[1].K
    matrices = essential_matrices(x1, x2, K1, K2, threshold_px=px, seed=seed)
    found = [answer(replace(straight, F=F), E) for E, F in matrices]
    if not found:
        return None
    surest = max(found, key=lambda estimate: estimate.confidence)
    return replace(surest, x1=collected.x1 * ready.factors[0], x2=collected.x2 * ready.factors[1])


def _undistorted(matches: MatchSet, cameras: Sequence[Intrinsics]) -> MatchSet:
    x1, x2 = (
        camera.undistort(x) if camera.undistort else x
        for camera, x in zip(cameras, (matches.x1, matches.x2), strict=True)
    )
    return replace(matches, x1=x1, x2=x2)


def describe_from_matches(
    sets: Sequence[MatchSet] | ReadyMatches,
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    pixel_factors: Factors = (1.0, 1.0),
) -> Described:
    """Return F of `estimate_from_matches` for the same arguments and its facts, without what is learnt from them."""
    options = EstimatorSettings(threshold_px=hand_over.threshold_px)
    ready = sets if isinstance(sets, ReadyMatches) else ready_matches(sets, hand_over, pixel_factors)
    tried, best = _try_all(ready, estimator, seed, hand_over, options)
    if best.F is None:
        return Described(F=None, facts=None)
    H, _ = _homography(best, options.threshold_px)
    F = _to_given_pixels(best.F, ready.factors)
    facts = _facts(tried, best, H, options.threshold_px)
    return Described(F=F.T if ready.turned and F is not None else F, facts=facts)


def best_fundamental(
    sets: Sequence[MatchSet] | ReadyMatches,
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    pixel_factors: Factors = (1.0, 1.0),
) -> FloatArray | None:
    """Return F of `estimate_from_matches` for the same arguments, in about half the time: nothing is verified."""
    options = EstimatorSettings(threshold_px=hand_over.threshold_px)
    ready = sets if isinstance(sets, ReadyMatches) else ready_matches(sets, hand_over, pixel_factors)
    _, best = _try_all(ready, estimator, seed, hand_over, options)
    F = None if best.F is None else _to_given_pixels(best.F, ready.factors)
    return F.T if ready.turned and F is not None else F


def _in_order(sets: Sequence[MatchSet], factors: Factors) -> tuple[Sequence[MatchSet], Factors, bool]:
    """Return sets and factors with the images in the order that the matches decide, and whether that is the other."""
    if not sets:
        raise SettingsError("no set of matches was given")
    sets = [with_checked_points(matches) for matches in sets]
    for matches in sets:
        x1, x2 = (matches.x1 / factors[0]).reshape(-1), (matches.x2 / factors[1]).reshape(-1)
        unlike = np.flatnonzero(x1 != x2)
        if len(unlike):
            if x1[unlike[0]] < x2[unlike[0]]:
                break
            return [one.swapped() for one in sets], (factors[1], factors[0]), True
    return sets, factors, False


def _try_all(
    ready: ReadyMatches, estimator: str, seed: int, how: HandOver, options: EstimatorSettings
) -> tuple[list[_Hypothesis], _Hypothesis]:
    """Return all hypotheses, and the best."""
    tried = [_try(one, estimator, seed, how, options) for one in ready.hypotheses]
    return tried, max(tried, key=lambda hypothesis: hypothesis.score)


def _scale(matches: MatchSet, factor1: float, factor2: float) -> MatchSet:
    if factor1 == factor2 == 1.0:
        return matches
    D1, D2 = (np.diag([1 / factor, 1 / factor, 1.0]) for factor in (factor1, factor2))
    sizes = matches.image_sizes
    if sizes is not None:
        (width1, height1), (width2, height2) = sizes
        sizes = (width1 * factor1, height1 * factor1), (width2 * factor2, height2 * factor2)
    return replace(
        matches,
        x1=matches.x1 * factor1,
        x2=matches.x2 * factor2,
        scale1=matches.scale1 * factor1,
        scale2=matches.scale2 * factor2,
        rough_matrices=D2 @ matches.rough_matrices @ D1,
        image_sizes=sizes,
    )


def _to_given_pixels(F: FloatArray, factors: Factors) -> FloatArray | None:
    if factors == (1.0, 1.0):
        return F
    D1, D2 = (np.diag([1 / factor, 1 / factor, 1.0]) for factor in factors)
    return normalise_fundamental(D2 @ F @ D1)


def _try(ready: _Ready, estimator: str, seed: int, how: HandOver, settings: EstimatorSettings) -> _Hypothesis:
    """Estimate, collect, refine, score: one roll hypothesis."""
    found = fit(estimator, ready.handed, seed=seed, settings=settings)
    F, wide, weights = found.F, ready.wide, ready.weights
    if F is None:
        return _Hypothesis(found=found, ready=ready, collected=ready.handed)
    if how.refine:
        F = refine_fundamental(F, wide.x1, wide.x2, weights)
    if how.collect:
        score = ready.evidence.score(F)
        # Drop the matches that are likelier wrong than right even where they agree with F (Bayes).
        rate = chance_rate(F, wide.x1, wide.x2, settings.threshold_px)
        wide = wide.take(weights > rate * (1.0 - weights))
    else:
        score = float(np.count_nonzero(sampson_distance(F, wide.x1, wide.x2) < settings.threshold_px))
    return _Hypothesis(found=found, ready=ready, collected=wide, F=F, score=score)


def _homography(best: _Hypothesis, px: float) -> tuple[FloatArray | None, Geometry | None]:
    """Return the best homography of the supporters of F, without F of all matches, and its kind."""
    x1, x2 = best.collected.x1, best.collected.x2
    if best.F is not None:
        near = sampson_distance(best.F, x1, x2) < px
        x1, x2 = x1[near], x2[near]
    H = degeneracy.fit_homography(x1, x2, degeneracy.PLANE_FACTOR * px)
    if H is None:
        return None, None
    on = _on_homography(H, best.collected, px)
    sizes = best.collected.image_sizes
    if best.F is None:
        x1, x2 = best.collected.x1, best.collected.x2
        support, total = distinct_count(x1[on], x2[on]), distinct_count(x1, x2)
        if support < max(MIN_MATCHES, _MOST * total) or chance_of_homography(support, total, x2, px) > _SURE_BY_CHANCE:
            return None, None
    if not on.any():
        return None, None
    return H, degeneracy.kind_of_homography(H, best.collected.x1[on], best.collected.x2[on], sizes)


def _on_homography(H: FloatArray, matches: MatchSet, px: float) -> BoolArray:
    distance = degeneracy.homography_distance(H, matches.x1, matches.x2)
    return np.asarray(distance < degeneracy.PLANE_FACTOR * px)


def _homography_in_given_pixels(H: FloatArray, factors: Factors) -> FloatArray:
    given = np.diag([factors[1], factors[1], 1.0]) @ H @ np.diag([1 / factors[0], 1 / factors[0], 1.0])
    return np.asarray(given / np.linalg.norm(given))


def _facts(tried: Sequence[_Hypothesis], best: _Hypothesis, H: FloatArray | None, px: float) -> Facts:
    assert best.F is not None
    others = tuple(h.F for h in tried if h is not best and h.F is not None)
    ready = best.ready
    odds = ready.evidence.single, ready.evidence.weights
    return describe_estimate(best.F, H, ready.matches, ready.handed, best.collected, px, others, odds)


def _without_fundamental(tried: Sequence[_Hypothesis], best: _Hypothesis, kind: Geometry | None) -> Verdict:
    if kind is not None:
        return Verdict(status=Status.DEGENERATE, geometry=kind, confidence=np.nan, message=MESSAGES[kind])
    # An estimator that found nothing says more than one that was not even started.
    telling = next((h.found for h in tried if h.found.status is Status.NO_MODEL), best.found)
    return Verdict(status=telling.status, geometry=Geometry.NONE, confidence=np.nan, message=telling.message)
