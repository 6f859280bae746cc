"""From matches to F: roll hypotheses, hand-over, refinement, support, status (paper, section 4.7)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from epiprior.errors import SettingsError
from epiprior.estimators.evidence import spread_evidence
from epiprior.estimators.handover import HandOver, hand_over
from epiprior.estimators.protocol import EstimatorSettings
from epiprior.estimators.registry import Fit, fit
from epiprior.geometry import normalise_fundamental, refine_fundamental, sampson_distance
from epiprior.types import FloatArray, FundamentalEstimate, MatchSet, Status
from epiprior.verification.chance import chance_rate
from epiprior.verification.judge import judge
from epiprior.verification.measures import known_plausibility, spread_of

Factors = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class _Hypothesis:
    """The outcome of one roll hypothesis: F and what supports it."""

    found: Fit
    handed: MatchSet
    collected: MatchSet
    F: FloatArray | None = None
    score: float = -1.0
    roll_deg: float = 0.0


def estimate_from_matches(
    sets: Sequence[MatchSet],
    *,
    estimator: str,
    seed: int = 0,
    hand_over: HandOver,
    settings: EstimatorSettings | None = None,
    pixel_factors: Factors = (1.0, 1.0),
) -> FundamentalEstimate:
    """Run an estimator on each of the sets, one per roll hypothesis, and return the best supported F.

    Each set is sorted best first; standard matches are a single set. Thresholds are meant in working pixels:
    `pixel_factors` are given pixels per working pixel in both images. `settings` replaces the estimator's own with the
    threshold of `hand_over`. `iterations` of the result adds up over the sets. Raises what `epiprior.estimators.fit`
    raises, and SettingsError without any set.

    Paper: the F with more inliers wins. Ours, where `hand_over.collect`: what all matches of the set say for F decides,
    each weighted by its probability and each part of the images once, times the plausibility of the cameras
    (`epiprior.estimators.evidence`). A thousand improbable matches then weigh less than fifty good ones.
    """
    if not sets:
        raise SettingsError("no set of matches was given")
    options = settings or EstimatorSettings(threshold_px=hand_over.threshold_px)
    start = time.perf_counter()
    tried = _try_all(sets, estimator, seed, hand_over, options, pixel_factors)
    best = max(tried, key=lambda hypothesis: hypothesis.score)
    status, message = _status(tried, best, options.threshold_px)
    collected, raw_F = best.collected, None if best.F is None else _to_given_pixels(best.F, pixel_factors)
    inliers = np.zeros(len(collected), dtype=np.bool_)
    if best.F is not None and status is Status.OK:
        inliers = sampson_distance(best.F, collected.x1, collected.x2) < options.threshold_px
    given = _scale(collected, *pixel_factors)
    drawn = [hypothesis.found.iterations for hypothesis in tried]
    running = sum(hypothesis.found.seconds for hypothesis in tried)
    return FundamentalEstimate(
        status=status,
        F=raw_F if status is Status.OK else None,
        raw_F=raw_F,
        x1=given.x1,
        x2=given.x2,
        inliers=inliers,
        support=int(inliers.sum()),
        iterations=sum(n for n in drawn if n is not None) if any(n is not None for n in drawn) else None,
        estimator=estimator,
        version=best.found.version,
        roll_deg=best.roll_deg,
        message=message,
        seconds={"estimator": running, "support": time.perf_counter() - start - running},
        spread=spread_of(collected.x1[inliers], collected.x2[inliers]),
        plausibility=known_plausibility(raw_F, given.image_sizes),
    )


def best_fundamental(
    sets: Sequence[MatchSet], *, estimator: str, seed: int = 0, hand_over: HandOver, pixel_factors: Factors = (1.0, 1.0)
) -> FloatArray | None:
    """Return `raw_F` of `estimate_from_matches` for the same arguments, in about half the time: nothing is verified."""
    options = EstimatorSettings(threshold_px=hand_over.threshold_px)
    tried = _try_all(sets, estimator, seed, hand_over, options, pixel_factors)
    best = max(tried, key=lambda hypothesis: hypothesis.score)
    return None if best.F is None else _to_given_pixels(best.F, pixel_factors)


def _try_all(
    sets: Sequence[MatchSet], estimator: str, seed: int, how: HandOver, options: EstimatorSettings, factors: Factors
) -> list[_Hypothesis]:
    return [_try(_scale(matches, 1 / factors[0], 1 / factors[1]), estimator, seed, how, options) for matches in sets]


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


def _try(matches: MatchSet, estimator: str, seed: int, how: HandOver, settings: EstimatorSettings) -> _Hypothesis:
    """Hand over, estimate, collect, refine, score: one roll hypothesis."""
    handed = hand_over(matches, how)
    found = fit(estimator, handed, seed=seed, settings=settings)
    F, roll_deg = found.F, matches.roll_deg
    if F is None:
        return _Hypothesis(found=found, handed=handed, collected=handed, roll_deg=roll_deg)
    wide = matches.one_to_one() if how.collect else handed
    weights = np.nan_to_num(wide.probability, nan=1.0)
    if how.refine:
        F = refine_fundamental(F, wide.x1, wide.x2, weights)
    if how.collect:
        score = spread_evidence(F, matches)
        # Drop the matches that are likelier wrong than right even where they agree with F (Bayes).
        rate = chance_rate(F, wide.x1, wide.x2, settings.threshold_px)
        wide = wide.take(weights > rate * (1.0 - weights))
    else:
        score = float(np.count_nonzero(sampson_distance(F, wide.x1, wide.x2) < settings.threshold_px))
    return _Hypothesis(found=found, handed=handed, collected=wide, F=F, score=score, roll_deg=roll_deg)


def _status(tried: Sequence[_Hypothesis], best: _Hypothesis, threshold_px: float) -> tuple[Status, str]:
    """Judge F on what was handed over, and where that does not suffice, on what was collected."""
    if best.F is None:
        # An estimator that found nothing says more than one that was not even started.
        telling = next((h.found for h in tried if h.found.status is Status.NO_MODEL), best.found)
        return telling.status, telling.message
    status, message = judge(best.F, best.handed.x1, best.handed.x2, threshold_px)
    if status is Status.OK or best.collected is best.handed:
        return status, message
    wider = judge(best.F, best.collected.x1, best.collected.x2, threshold_px)
    return wider if wider[0] is Status.OK else (status, message)
