"""Two photographs in, F out: on ranked matches, on standard matches, or on ranked ones where standard ones fail."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

from epiprior.errors import ImageError, SettingsError
from epiprior.estimators import find_estimator
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.images import Photograph, View, blank_photograph, load_photograph
from epiprior.features.shortage import explain_shortage
from epiprior.matching.baselines import generalized_matches, standard_set
from epiprior.matching.pair import Stopwatch, prepare_pair
from epiprior.presets import PAPER, Mode, PreprocessSettings, check_choice, find_preset
from epiprior.rank import rank_matches
from epiprior.types import Features, FundamentalEstimate, MatchSet, RankedMatches, Status
from epiprior.verification.cascade import CascadeRule, load_cascade_rule
from epiprior.verification.confidence import check_min_confidence


def estimate_fundamental(
    image1: View | None,
    image2: View | None,
    *,
    estimator: str = "epiprior",
    mode: Mode = "preprocess",
    preset: str = "default",
    seed: int = 0,
    threshold_px: float | None = None,
    features1: Features | None = None,
    features2: Features | None = None,
    ranked: RankedMatches | None = None,
    hand_over: HandOver | None = None,
    rule: CascadeRule | None = None,
    settings: PreprocessSettings | None = None,
    min_confidence: float | None = None,
) -> FundamentalEstimate:
    """Estimate the fundamental matrix of two photographs.

    Parameters
    ----------
    image1, image2 : The photographs: a file that OpenCV reads, or uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4)
        RGBA. None only where features are handed in, see `rank_matches`.
    estimator : Name of a robust estimator, see `epiprior.list_estimators`; by default the one that did best.
    mode : ``preprocess``: matches are ranked by `rank_matches` first. ``standard``: the standard matches X_L, the
        baseline; for `generalized-ransac` those of `generalized_matches`. ``cascade``: the standard matches first; the
        ranked ones only if `rule` does not keep that estimate. Features are found once for both.
    preset : ``default``, ``fast``, ``thorough`` or ``paper``, see `rank_matches`.
    seed : >= 0; the same seed gives the same bytes.
    threshold_px : Inlier threshold, instead of the hand-over's. Like all thresholds it is meant at working size: an
        image larger than the preset's `max_image_size` (1024) is measured as if it had that size.
    features1, features2 : Used instead of detected ones, pixels of the images as given.
    ranked : From an earlier `rank_matches` on these images, to save the time.
    hand_over : Instead of that chosen on validation scenes for this estimator and input; a cascade, of two, takes none.
    rule : Of the cascade, instead of the one that was chosen on validation scenes.
    settings : Instead of the preset's. Standard matches are made of the same features.
    min_confidence : The status is ``ok`` from this confidence on, in [0, 1], instead of the one that about one in a
        hundred pairs of photographs of different places reaches.

    Returns
    -------
    `x1`, `x2`, `inliers`, `F` and `H` in pixels of the images as given; with the images in the other order, the same
    transposed. `input` tells which matches it comes from. A cascade that did not keep the estimate on standard matches
    counts the seconds of that attempt as ``standard input``, beside those of the second. It returns the second
    estimate, except where only the first is ``ok``.

    Raises
    ------
    ImageError, ModelError, SettingsError, EstimatorError : For input that cannot be used; the message names it.

    References
    ----------
    Paper, section 4.7; its results end with the advice that ``cascade`` follows.
    """
    find_estimator(estimator)
    check_choice("mode", mode, get_args(Mode))
    if mode != "cascade" and rule is not None:
        raise SettingsError(f"rule is of the cascade, but mode is {mode!r}")
    if min_confidence is not None:
        check_min_confidence(min_confidence)
    if mode == "cascade" and hand_over is not None:
        raise SettingsError("hand_over is for one input, but mode 'cascade' has two")
    chosen = settings or find_preset(preset)
    found = (features1, features2)
    given: dict[str, Any] = {"features1": features1, "features2": features2}

    def estimate(kind: str, sets: Sequence[MatchSet], seconds: Mapping[str, float]) -> FundamentalEstimate:
        how = hand_over or load_hand_overs()[estimator][chosen.model if kind == chosen.name else kind]
        if threshold_px is not None:
            how = replace(how, threshold_px=threshold_px)
        sizes = sets[0].image_sizes or (_size_of(image1), _size_of(image2))
        limit = chosen.features.max_image_size
        factor1, factor2 = (blank_photograph((round(w), round(h)), limit).factor for w, h in sizes)
        factors = factor1, factor2
        result = estimate_from_matches(
            sets, estimator=estimator, seed=seed, hand_over=how, pixel_factors=factors, min_confidence=min_confidence
        )
        message = result.message
        if result.status is Status.TOO_FEW_MATCHES:
            why = explain_shortage((image1, image2), (features1, features2), chosen.features)
            message += f"; {why}" if why else ""
        return replace(result, input=kind, message=message, seconds={**seconds, **result.seconds})

    first = None
    if mode != "preprocess":
        as_paper = replace(chosen.features, root=PAPER.features.root, centred=PAPER.features.centred)
        watch, kind = Stopwatch(), "standard"
        if estimator == "generalized-ransac":
            kind = "generalized"
            with watch.step("generalized matches"):
                matches = generalized_matches(image1, image2, features=as_paper, **given)
        elif ranked is not None:
            matches = ranked.standard
        else:
            baseline = replace(PAPER, features=as_paper)
            prepared = prepare_pair(image1, image2, baseline, **given, watch=watch, ordered=True)
            first_found, second_found = prepared.features
            found = (second_found, first_found) if prepared.turned else (first_found, second_found)
            matches = standard_set(prepared, baseline)
        first = estimate(kind, [matches], watch.seconds)
        if mode == "standard" or (rule or load_cascade_rule()).keeps(first):
            return first
    if ranked is None:
        ranked = rank_matches(image1, image2, settings=chosen, features1=found[0], features2=found[1])
    second = estimate(chosen.name, ranked.sets, ranked.seconds)
    if first is None:
        return second
    best = first if first and not second else second
    return replace(best, seconds={"standard input": sum(first.seconds.values()), **second.seconds})


def _size_of(image: View | None) -> tuple[int, int]:
    if image is None:
        raise ImageError("an image is None, and the ranked matches do not know its size")
    return image.size if isinstance(image, Photograph) else load_photograph(image).size
