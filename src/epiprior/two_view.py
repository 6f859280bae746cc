"""Two photographs in, F out: on ranked matches, on standard matches, or on ranked ones where simple ones fail."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

from epiprior.errors import ImageError, SettingsError
from epiprior.estimators import find_estimator
from epiprior.estimators.essential import Intrinsics
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.detect import explain_shortage
from epiprior.features.images import Photograph, View, blank_photograph, load_photograph
from epiprior.matching.baselines import generalized_set, snn_features, snn_set, standard_set
from epiprior.matching.pair import Stopwatch, prepare_pair
from epiprior.presets import PAPER, FeatureSettings, Mode, PreprocessSettings, check_choice, check_number, find_preset
from epiprior.rank import rank_matches
from epiprior.types import Features, FundamentalEstimate, MatchSet, RankedMatches, Status
from epiprior.verification.cascade import CascadeRule, load_cascade_rule

_Pair = tuple[Features | None, Features | None]


def estimate_fundamental(
    image1: View | None,
    image2: View | None,
    *,
    estimator: str = "epiprior",
    mode: Mode | None = None,
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
    intrinsics: tuple[Intrinsics, Intrinsics] | None = None,
) -> FundamentalEstimate:
    """Estimate the fundamental matrix of two photographs.

    Parameters
    ----------
    image1, image2 : The photographs: a file that OpenCV reads, or uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4)
        RGBA. None only where features are handed in, see `rank_matches`.
    estimator : Name of a robust estimator, see `epiprior.list_estimators`; by default the one that did best.
    mode : ``cascade``: simple matches first, those of `snn_matches`; the ranked ones of `rank_matches` only if `rule`
        does not keep that estimate. Features are found once for both. ``preprocess``: ranked matches at once.
        ``standard``: the standard matches X_L, the paper's baseline; for `generalized-ransac` those of
        `generalized_matches`. None: ``preprocess`` where `ranked` or `hand_over` is given, else ``cascade``.
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
    intrinsics : What is known of both cameras, pixels of the images as given. The result is as without, and its
        `calibrated` the estimate under these: an essential matrix of the same matches, and its F.

    Returns
    -------
    `x1`, `x2`, `inliers`, `F` and `H` in pixels of the images as given; with the images in the other order, the same
    transposed. `input` tells which matches it comes from. A cascade that did not keep the estimate on simple matches
    counts the seconds of that attempt as ``first input``, beside those of the second. It returns the second estimate,
    except where only the first is ``ok``, or tells of a homography while the second tells nothing.

    Raises
    ------
    ImageError, ModelError, SettingsError, EstimatorError : For input that cannot be used; the message names it.

    References
    ----------
    Paper, section 4.7; its results end with the advice that ``cascade`` follows.
    """
    find_estimator(estimator)
    mode = mode or ("cascade" if ranked is None and hand_over is None else "preprocess")
    check_choice("mode", mode, get_args(Mode))
    if mode != "cascade" and rule is not None:
        raise SettingsError(f"rule is of the cascade, but mode is {mode!r}")
    if min_confidence is not None:
        check_number("min_confidence", min_confidence, 0.0, 1.0)
    if mode == "cascade" and hand_over is not None:
        raise SettingsError("hand_over is for one input, but mode 'cascade' has two")
    chosen = settings or find_preset(preset)
    given = found = (features1, features2)

    def estimate(kind: str, sets: Sequence[MatchSet], seconds: Mapping[str, float]) -> FundamentalEstimate:
        how = hand_over or load_hand_overs()[estimator][chosen.model if kind == chosen.name else kind]
        if threshold_px is not None:
            how = replace(how, threshold_px=threshold_px)
        sizes = sets[0].image_sizes or (_size_of(image1), _size_of(image2))
        limit = chosen.features.max_image_size
        factor1, factor2 = (blank_photograph((round(w), round(h)), limit).factor for w, h in sizes)
        factors = factor1, factor2
        result = estimate_from_matches(
            sets,
            estimator=estimator,
            seed=seed,
            hand_over=how,
            pixel_factors=factors,
            min_confidence=min_confidence,
            intrinsics=intrinsics,
        )
        calibrated = None if result.calibrated is None else replace(result.calibrated, input=kind)
        message = result.message
        if result.status is Status.TOO_FEW_MATCHES:
            why = explain_shortage((image1, image2), (features1, features2), chosen.features)
            message += f"; {why}" if why else ""
        steps = {**seconds, **result.seconds}
        return replace(result, input=kind, message=message, calibrated=calibrated, seconds=steps)

    first = None
    if mode != "preprocess":
        kind = "snn" if mode == "cascade" else "generalized" if estimator == "generalized-ransac" else "standard"
        watch = Stopwatch()
        if kind == "standard" and ranked is not None:
            matches = ranked.standard
        else:
            matches, found = _simple_matches(kind, image1, image2, chosen.features, given, watch)
        first = estimate(kind, [matches], watch.seconds)
        if mode == "standard":
            return first
        rule = rule or load_cascade_rule()
        if rule.keeps(first):
            return first
    if ranked is None:
        ranked = rank_matches(image1, image2, settings=chosen, features1=found[0], features2=found[1])
    second = estimate(chosen.name, ranked.sets, ranked.seconds)
    if first is None or rule is None:
        return second
    best = rule.choose(first, second)
    return replace(best, seconds={"first input": sum(first.seconds.values()), **second.seconds})


def _simple_matches(
    kind: str, image1: View | None, image2: View | None, features: FeatureSettings, given: _Pair, watch: Stopwatch
) -> tuple[MatchSet, _Pair]:
    """Return the matches of an input that is not ranked, and the features of both images."""
    as_paper = replace(features, root=PAPER.features.root, centred=PAPER.features.centred)
    settings = replace(PAPER, features=snn_features(features) if kind == "snn" else as_paper)
    how: dict[str, Any] = {"features1": given[0], "features2": given[1], "watch": watch, "ordered": True}
    prepared = prepare_pair(image1, image2, settings, **how)
    if kind == "generalized":
        with watch.step("generalized matches"):
            matches = generalized_set(prepared)
    else:
        matches = snn_set(prepared) if kind == "snn" else standard_set(prepared, settings)
    first, second = prepared.features
    return matches, (second, first) if prepared.turned else (first, second)


def _size_of(image: View | None) -> tuple[int, int]:
    if image is None:
        raise ImageError("an image is None, and the ranked matches do not know its size")
    return image.size if isinstance(image, Photograph) else load_photograph(image).size
