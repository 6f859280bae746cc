"""From matches to F: roll hypotheses, hand-over, refinement, support, confidence (paper, section 4.7).

The two images are always taken in one order, whichever they are given in, and the answer is turned back: it is then the
same, F transposed. Estimators draw samples and break ties by the order of numbers, so they would differ else.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from epiprior.errors import SettingsError
from epiprior.estimators.essential import WORTH, Intrinsics, essential_matrices
from epiprior.estimators.handover import HandOver, hand_over
from epiprior.estimators.registry import Fit, fit, with_checked_points
from epiprior.geometry import MIN_MATCHES, normalise_fundamental, refine_fundamental, sampson_distance
from epiprior.types import BoolArray, FloatArray, FundamentalEstimate, Geometry, MatchSet, Status
from epiprior.verification import degeneracy
from epiprior.verification.cascade import FLAT
from epiprior.verification.chance import chance_rate, distinct_count
from epiprior.verification.confidence import MESSAGES, Verdict, judge, load_confidence
from epiprior.verification.facts import Facts, chance_of_homography, describe_estimate
from epiprior.verification.measures import SpreadEvidence

Factors = tuple[float, float]
_SURE_BY_CHANCE = -3.0  # of a homography without an F: expected once in a thousand pairs by chance,
_MOST = 0.5  # and most of the matches lie on it


class _Ready:
    """The matches of one roll hypothesis, in working pixels, with all that is the same for every estimate on them."""

    def __init__(self, matches: MatchSet, how: HandOver) -> None:
        self.matches, self.how, self.handed = matches, how, hand_over(matches, how)
        self.evidence = SpreadEvidence(matches)
        self.wide = self.evidence.single if how.collect else self.handed
        self.weights = np.nan_to_num(self.wide.probability, nan=1.0)


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


def ready_matches(sets: Sequence[MatchSet], hand_over: HandOver, pixel_factors: Factors = (1.0, 1.0)) -> ReadyMatches:
    """Return what `solve` makes of its arguments first, to estimate more than once on them."""
    start = time.perf_counter()
    sets, factors, turned = _in_order(sets, pixel_factors)
    ready = tuple(_Ready(_scale(matches, 1 / factors[0], 1 / factors[1]), hand_over) for matches in sets)
    return ReadyMatches(ready, factors, turned, time.perf_counter() - start)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """F of several roll hypotheses, and what is known of it; each is computed when it is first asked for."""

    tried: tuple[_Hypothesis, ...]
    ready: ReadyMatches
    threshold_px: float

    @cached_property
    def best(self) -> _Hypothesis:
        """The roll hypothesis whose F is best supported."""
        return max(self.tried, key=lambda hypothesis: hypothesis.score)

    @cached_property
    def F(self) -> FloatArray | None:  # noqa: N802
        """F in given pixels, (3, 3), the images in the order as given; None if there is none."""
        F = self._given_F
        return F.T if self.ready.turned and F is not None else F

    @property
    def _given_F(self) -> FloatArray | None:  # noqa: N802
        F, factors = self.best.F, self.ready.factors
        if F is None or factors == (1.0, 1.0):
            return F
        D1, D2 = (np.diag([1 / factor, 1 / factor, 1.0]) for factor in factors)
        return normalise_fundamental(D2 @ F @ D1)

    @cached_property
    def homography(self) -> tuple[FloatArray | None, Geometry | None]:
        """The best homography of the supporters of F, without F of all matches, and its kind; in working pixels."""
        return _homography(self.best, self.threshold_px)

    @cached_property
    def facts(self) -> Facts | None:
        """The facts that the confidence in F is learnt from; None without F."""
        best, ready = self.best, self.best.ready
        if best.F is None:
            return None
        others = tuple(h.F for h in self.tried if h is not best and h.F is not None)
        return describe_estimate(
            best.F, self.homography[0], ready.evidence, ready.handed, best.collected, self.threshold_px, others
        )


def solve(
    sets: Sequence[MatchSet] | ReadyMatches,
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    pixel_factors: Factors = (1.0, 1.0),
) -> Solution:
    """Run an estimator on each of the sets, one per roll hypothesis; arguments as for `estimate_from_matches`.

    F alone takes about half the time of an estimate: nothing is verified.
    """
    ready = sets if isinstance(sets, ReadyMatches) else ready_matches(sets, hand_over, pixel_factors)
    tried = tuple(_try(one, estimator, seed, hand_over) for one in ready.hypotheses)
    return Solution(tried=tried, ready=ready, threshold_px=hand_over.threshold_px)


def estimate_from_matches(
    sets: Sequence[MatchSet] | ReadyMatches,
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    pixel_factors: Factors = (1.0, 1.0),
    min_confidence: float | None = None,
    intrinsics: tuple[Intrinsics, Intrinsics] | None = None,
) -> FundamentalEstimate:
    """Run an estimator on each of the sets, one per roll hypothesis, and return the best supported F.

    Each set is sorted best first; standard matches are a single set. Thresholds are meant in working pixels:
    `pixel_factors` are given pixels per working pixel in both images. `min_confidence` replaces the confidence from
    which on the status is ``ok``. Sets that `ready_matches` has made ready with this hand-over save time; their factors
    hold. `iterations` of the result adds up over the sets. Under known `intrinsics`, of the images in given pixels,
    `calibrated` of the result is the surer of `essential_matrices`, by the same facts. Raises what
    `epiprior.estimators.fit` and `load_confidence` raise, and SettingsError without any set.

    Paper: the F with more inliers wins. Ours, where `hand_over.collect`: what all matches of the set say for F decides,
    each weighted by its probability and each part of the images once, times the plausibility of the cameras
    (`SpreadEvidence`). A thousand improbable matches then weigh less than fifty good ones.
    """
    start = time.perf_counter()
    solution = solve(sets, estimator=estimator, seed=seed, hand_over=hand_over, pixel_factors=pixel_factors)
    estimate = _answer(solution, estimator, min_confidence)
    if intrinsics and estimate.confidence >= WORTH and estimate.geometry not in FLAT:
        found = [_answer(one, estimator, min_confidence, E) for E, one in _under(intrinsics, solution, seed)]
        surest = max(found, key=lambda one: one.confidence, default=None)
        if surest is not None:
            estimate = replace(estimate, calibrated=replace(surest, x1=estimate.x1, x2=estimate.x2))
    running = sum(hypothesis.found.seconds for hypothesis in solution.tried)
    spent = time.perf_counter() - start + (solution.ready.seconds if solution.ready is sets else 0.0)
    estimate = replace(estimate, seconds={"estimator": running, "support": spent - running})
    return estimate.swapped() if solution.ready.turned else estimate


def _answer(
    solution: Solution, estimator: str, min_confidence: float | None, E: FloatArray | None = None
) -> FundamentalEstimate:
    """Return what is said of a solution, with the images in its own order."""
    ready, tried, best, px = solution.ready, solution.tried, solution.best, solution.threshold_px
    (H, kind), collected = solution.homography, best.collected
    if solution.facts is None:
        verdict = _without_fundamental(tried, best, kind)
    else:
        verdict = judge(solution.facts, kind, load_confidence(), min_confidence)
    flat = verdict.geometry in FLAT
    inliers = np.zeros(len(collected), np.bool_)
    if flat and H is not None:
        inliers = _on_homography(H, collected, px)
    elif best.F is not None:
        inliers = sampson_distance(best.F, collected.x1, collected.x2) < px
    drawn = [hypothesis.found.iterations for hypothesis in tried if hypothesis.found.iterations is not None]
    return FundamentalEstimate(
        status=verdict.status,
        F=solution._given_F,
        x1=collected.x1 * ready.factors[0],
        x2=collected.x2 * ready.factors[1],
        inliers=inliers,
        support=int(inliers.sum()),
        confidence=verdict.confidence,
        geometry=verdict.geometry,
        H=_homography_in_given_pixels(H, ready.factors) if flat and H is not None else None,
        E=E,
        iterations=sum(drawn) if drawn else None,
        estimator=estimator,
        version=best.found.version,
        roll_deg=best.ready.matches.roll_deg,
        message=verdict.message,
    )


def _under(
    intrinsics: tuple[Intrinsics, Intrinsics], solution: Solution, seed: int
) -> Iterator[tuple[FloatArray, Solution]]:
    """Yield essential matrices of the collected matches, and the solution with their F instead."""
    best, ready = solution.best, solution.ready
    given = intrinsics[::-1] if ready.turned else intrinsics
    both = [camera.in_working_pixels(factor) for camera, factor in zip(given, ready.factors, strict=True)]
    if any(camera.undistort for camera in both):
        own = _undistorted(best.ready.matches, both)
        best = replace(best, ready=_Ready(own, best.ready.how), collected=_undistorted(best.collected, both))
    x1, x2, K1, K2 = best.collected.x1, best.collected.x2, both[0].K, both[1].K
    for E, F in essential_matrices(x1, x2, K1, K2, threshold_px=solution.threshold_px, seed=seed):
        tried = (replace(best, F=F) if one is solution.best else one for one in solution.tried)
        yield E, replace(solution, tried=tuple(tried))


def _undistorted(matches: MatchSet, cameras: Sequence[Intrinsics]) -> MatchSet:
    x1, x2 = (
        camera.undistort(x) if camera.undistort else x
        for camera, x in zip(cameras, (matches.x1, matches.x2), strict=True)
    )
    return replace(matches, x1=x1, x2=x2)


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


def _try(ready: _Ready, estimator: str, seed: int, how: HandOver) -> _Hypothesis:
    """Estimate, collect, refine, score: one roll hypothesis."""
    found = fit(estimator, ready.handed, seed=seed, threshold_px=how.threshold_px)
    F, wide, weights = found.F, ready.wide, ready.weights
    if F is None:
        return _Hypothesis(found=found, ready=ready, collected=ready.handed)
    if how.refine:
        F = refine_fundamental(F, wide.x1, wide.x2, weights)
    if how.collect:
        score = float(ready.evidence.scores(F[None])[0])
        # Drop the matches that are likelier wrong than right even where they agree with F (Bayes).
        rate = chance_rate(F, wide.x1, wide.x2, how.threshold_px)
        wide = wide.take(weights > rate * (1.0 - weights))
    else:
        score = float(np.count_nonzero(sampson_distance(F, wide.x1, wide.x2) < how.threshold_px))
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


def _without_fundamental(tried: Sequence[_Hypothesis], best: _Hypothesis, kind: Geometry | None) -> Verdict:
    if kind is not None:
        return Verdict(status=Status.DEGENERATE, geometry=kind, confidence=np.nan, message=MESSAGES[kind])
    # An estimator that found nothing says more than one that was not even started.
    telling = next((h.found for h in tried if h.found.status is Status.NO_MODEL), best.found)
    return Verdict(status=telling.status, geometry=Geometry.NONE, confidence=np.nan, message=telling.message)
