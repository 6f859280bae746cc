"""From matches to F: roll hypotheses, hand-over, refinement, support, status (paper, section 4.7)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from epiprior.chance import chance_rate
from epiprior.errors import SettingsError
from epiprior.estimators import EstimatorSettings, find_estimator, fit
from epiprior.estimators.registry import Fit
from epiprior.estimators.verdict import judge
from epiprior.features import Image, load_photograph
from epiprior.geometry import normalise_fundamental, sampson_distance
from epiprior.handover import HandOver, hand_over, load_hand_overs
from epiprior.presets import find_preset
from epiprior.refine import refine_fundamental, weighted_score
from epiprior.types import FloatArray, FundamentalEstimate, MatchSet, RankedMatches, Status


def estimate_fundamental(
    image1: Image,
    image2: Image,
    *,
    estimator: str = "usac",
    preprocess: bool = True,
    preset: str = "default",
    seed: int = 0,
    threshold_px: float | None = None,
    ranked: RankedMatches | None = None,
    hand_over: HandOver | None = None,
) -> FundamentalEstimate:
    """Estimate the fundamental matrix of two photographs.

    Parameters
    ----------
    image1, image2 : path or ndarray
        The photographs: a file that OpenCV reads, or uint8 of shape (H, W) or (H, W, 3) RGB.
    estimator : str
        Name of a robust estimator, see `epiprior.estimators`.
    preprocess : bool
        Whether matches are ranked by `rank_matches` first. False: the standard matches X_L, the baseline.
    preset : str
        ``default`` or ``paper``.
    seed : int
        >= 0; the same seed gives the same bytes.
    threshold_px : float, optional
        Inlier threshold, instead of the hand-over's. Like all thresholds it is meant at working size: an
        image larger than the preset's `max_image_size` (1024) is measured as if it had that size.
    ranked : RankedMatches, optional
        From an earlier `rank_matches` on these images, to save the time.
    hand_over : HandOver, optional
        Instead of the one that was chosen on validation scenes for this estimator and input.

    Returns
    -------
    FundamentalEstimate
        `x1`, `x2`, `inliers` and `F` in pixels of the images as given.

    Raises
    ------
    ImageError, ModelError, SettingsError, EstimatorError
        For input that cannot be used; the message names it.

    References
    ----------
    Paper, section 4.7.
    """
    from epiprior.baselines import standard_matches
    from epiprior.preprocess import rank_matches

    find_estimator(estimator)
    settings = find_preset(preset)
    how = hand_over or load_hand_overs()[estimator][settings.name if preprocess else "standard"]
    if threshold_px is not None:
        how = replace(how, threshold_px=threshold_px)
    start = time.perf_counter()
    seconds: dict[str, float] = {}
    if preprocess:
        ranked = ranked or rank_matches(image1, image2, preset=preset)
        sets, seconds = ranked.sets, dict(ranked.seconds)
    else:
        sets = (ranked.standard if ranked else standard_matches(image1, image2),)
        seconds["standard matches"] = time.perf_counter() - start
    limit = settings.features.max_image_size
    factors = (load_photograph(image1, limit).factor, load_photograph(image2, limit).factor)
    estimate = estimate_from_matches(sets, estimator=estimator, seed=seed, hand_over=how, pixel_factors=factors)
    return replace(estimate, seconds=seconds | dict(estimate.seconds))


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
    pixel_factors: tuple[float, float] = (1.0, 1.0),
) -> FundamentalEstimate:
    """Run an estimator on each of the sets and return the best supported F.

    Parameters
    ----------
    sets : sequence of MatchSet
        One per roll hypothesis, at least one, each sorted best first; or a single set of standard matches.
    estimator : str
        Name in the registry.
    seed : int
        >= 0.
    hand_over : HandOver
        What the estimator gets of each set, and whether support is collected again and F refined.
    settings : EstimatorSettings, optional
        Instead of the estimator's own with the threshold of `hand_over`.
    pixel_factors : tuple of float
        Given pixels per working pixel in both images; thresholds are meant in working pixels.

    Returns
    -------
    FundamentalEstimate
        `iterations` adds up over the sets.

    Raises
    ------
    EstimatorError, FeatureError, SettingsError
        As `epiprior.estimators.fit` does; SettingsError also without any set.

    Notes
    -----
    Paper: the F with more inliers wins. Ours, where `hand_over.collect`: the sums of the probabilities of the
    inliers decide, each lowered by its squared distance, over the one-to-one matches of the whole set. A
    thousand improbable matches then weigh less than fifty good ones.
    """
    if not sets:
        raise SettingsError("no set of matches was given")
    options = settings or EstimatorSettings(threshold_px=hand_over.threshold_px)
    start = time.perf_counter()
    scaled = [_scale(matches, 1 / pixel_factors[0], 1 / pixel_factors[1]) for matches in sets]
    tried = [_try(matches, estimator, seed, hand_over, options) for matches in scaled]
    best = max(tried, key=lambda hypothesis: hypothesis.score)
    status, message = _verdict(tried, best, options.threshold_px)
    collected, F = best.collected, best.F if status is Status.OK else None
    inliers = np.zeros(len(collected), dtype=np.bool_)
    if F is not None:
        inliers = sampson_distance(F, collected.x1, collected.x2) < options.threshold_px
        F = _to_given_pixels(F, pixel_factors)
    given = _scale(collected, *pixel_factors)
    drawn = [hypothesis.found.iterations for hypothesis in tried]
    running = sum(hypothesis.found.seconds for hypothesis in tried)
    return FundamentalEstimate(
        status=status,
        F=F,
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
    )


def _scale(matches: MatchSet, factor1: float, factor2: float) -> MatchSet:
    if factor1 == factor2 == 1.0:
        return matches
    x1, x2 = matches.x1 * factor1, matches.x2 * factor2
    return replace(matches, x1=x1, x2=x2, scale1=matches.scale1 * factor1, scale2=matches.scale2 * factor2)


def _to_given_pixels(F: FloatArray, factors: tuple[float, float]) -> FloatArray | None:
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
        score = weighted_score(F, wide.x1, wide.x2, weights)
        wide = _worth_having(F, wide, weights, settings.threshold_px)
    else:
        score = float(np.count_nonzero(sampson_distance(F, wide.x1, wide.x2) < settings.threshold_px))
    return _Hypothesis(found=found, handed=handed, collected=wide, F=F, score=score, roll_deg=roll_deg)


def _worth_having(F: FloatArray, matches: MatchSet, weights: FloatArray, threshold_px: float) -> MatchSet:
    """Drop the matches that are likelier wrong than right even where they agree with F (Bayes)."""
    rate = chance_rate(F, matches.x1, matches.x2, threshold_px)
    return matches.take(weights > rate * (1.0 - weights))


def _verdict(tried: Sequence[_Hypothesis], best: _Hypothesis, threshold_px: float) -> tuple[Status, str]:
    """Judge F on what was handed over, and where that does not suffice, on what was collected."""
    if best.F is None:
        # An estimator that found nothing says more than one that was not even started.
        telling = next((h.found for h in tried if h.found.status is Status.NO_MODEL), best.found)
        return telling.status, telling.message
    status, message = judge(best.F, best.handed.x1, best.handed.x2, threshold_px)
    if status is not Status.OK and best.collected is not best.handed:
        wider, _ = judge(best.F, best.collected.x1, best.collected.x2, threshold_px)
        if wider is Status.OK:
            return Status.OK, ""
    return status, message
