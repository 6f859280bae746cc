"""Two photographs in, F out: on ranked matches, on standard matches, or on the former where the latter do not do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

from epiprior import rank
from epiprior.errors import ImageError, SettingsError
from epiprior.estimators import find_estimator
from epiprior.estimators.handover import HandOver, load_hand_overs
from epiprior.estimators.run import estimate_from_matches
from epiprior.features.images import Photograph, View, blank_photograph, load_photograph
from epiprior.features.shortage import explain_shortage
from epiprior.matching.baselines import generalized_matches, standard_set
from epiprior.matching.pair import prepare_pair
from epiprior.mode import Mode
from epiprior.presets import PreprocessSettings, find_preset
from epiprior.stopwatch import Stopwatch
from epiprior.types import Features, FundamentalEstimate, MatchSet, RankedMatches, Status
from epiprior.verification.cascade import CascadeRule, load_cascade_rule

_OWN_CANDIDATES = "generalized-ransac"


def estimate_fundamental(
    image1: View | None,
    image2: View | None,
    *,
    estimator: str = "epiprior",
    mode: Mode | None = None,
    preprocess: bool | None = None,
    preset: str = "default",
    seed: int = 0,
    threshold_px: float | None = None,
    features1: Features | None = None,
    features2: Features | None = None,
    ranked: RankedMatches | None = None,
    hand_over: HandOver | None = None,
    rule: CascadeRule | None = None,
    settings: PreprocessSettings | None = None,
) -> FundamentalEstimate:
    """Estimate the fundamental matrix of two photographs.

    Parameters
    ----------
    image1, image2 : path, ndarray, Photograph or None
        The photographs: a file that OpenCV reads, or uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4) RGBA. None
        only where features are handed in, see `rank_matches`.
    estimator : str
        Name of a robust estimator, see `epiprior.estimators`; by default the one that did best.
    mode : str, optional
        ``preprocess`` (if neither this nor `preprocess` is given): matches are ranked by `rank_matches` first.
        ``standard``: the standard matches X_L, the baseline; for `generalized-ransac` those that belong to it, of
        `generalized_matches`. ``cascade``: the standard matches first; the ranked
        ones only if `rule` does not keep that estimate. Features are found once for both.
    preprocess : bool, optional
        Short for `mode`: True for ``preprocess``, False for ``standard``.
    preset : str
        ``default`` or ``paper``.
    seed : int
        >= 0; the same seed gives the same bytes.
    threshold_px : float, optional
        Inlier threshold, instead of the hand-over's. Like all thresholds it is meant at working size: an
        image larger than the preset's `max_image_size` (1024) is measured as if it had that size.
    features1, features2 : Features, optional
        Used instead of detected ones, pixels of the images as given.
    ranked : RankedMatches, optional
        From an earlier `rank_matches` on these images, to save the time.
    hand_over : HandOver, optional
        Instead of the one that was chosen on validation scenes for this estimator and input. A cascade has two
        inputs and takes none.
    rule : CascadeRule, optional
        Of the cascade, instead of the one that was chosen on validation scenes.
    settings : PreprocessSettings, optional
        Instead of the preset's. The standard matches take over how features are found.

    Returns
    -------
    FundamentalEstimate
        `x1`, `x2`, `inliers` and `F` in pixels of the images as given. `input` tells which matches it comes from.
        A cascade that did not keep the estimate on standard matches counts the seconds of that attempt as
        ``standard input``, beside those of the second. It returns the second estimate, except where only the
        first has an F.

    Raises
    ------
    ImageError, ModelError, SettingsError, EstimatorError
        For input that cannot be used; the message names it.

    References
    ----------
    Paper, section 4.7; its results end with the advice that ``cascade`` follows.
    """
    find_estimator(estimator)
    chosen = _chosen_mode(mode, preprocess)
    if chosen != "cascade" and rule is not None:
        raise SettingsError(f"rule is of the cascade, but mode is {chosen!r}")
    if chosen == "cascade" and hand_over is not None:
        raise SettingsError("hand_over is for one input, but mode 'cascade' has two")
    request = _Request(
        images=(image1, image2),
        features=(features1, features2),
        estimator=estimator,
        settings=settings or find_preset(preset),
        seed=seed,
        threshold_px=threshold_px,
        ranked=ranked,
        hand_over=hand_over,
    )
    if chosen == "preprocess":
        return request.on_ranked()
    if chosen == "standard":
        return request.on_standard()[0]
    return request.cascade(rule or load_cascade_rule())


def _size_of(image: View | None) -> tuple[int, int]:
    if image is None:
        raise ImageError("an image is None, and the ranked matches do not know its size")
    return image.size if isinstance(image, Photograph) else load_photograph(image).size


def _chosen_mode(mode: Mode | None, preprocess: bool | None) -> Mode:
    if mode is not None and mode not in get_args(Mode):
        raise SettingsError(f"mode is {mode!r}, known: {', '.join(get_args(Mode))}")
    if preprocess is None:
        return mode or "preprocess"
    short: Mode = "preprocess" if preprocess else "standard"
    if mode not in (None, short):
        raise SettingsError(f"mode is {mode!r}, but preprocess is {preprocess}: give one of them")
    return short


@dataclass(frozen=True, kw_only=True)
class _Request:
    """What `estimate_fundamental` was asked for; each method answers on one input."""

    images: tuple[View | None, View | None]
    features: tuple[Features | None, Features | None]
    estimator: str
    settings: PreprocessSettings
    seed: int
    threshold_px: float | None
    ranked: RankedMatches | None
    hand_over: HandOver | None

    def on_standard(self) -> tuple[FundamentalEstimate, tuple[Features, Features] | None]:
        """Return the estimate without preprocessing, and the features that were found for it, if they are at hand."""
        if self.estimator == _OWN_CANDIDATES:
            watch = Stopwatch()
            with watch.step("generalized matches"):
                first, second = self.features
                candidates = generalized_matches(
                    *self.images, features=self._baseline().features, features1=first, features2=second
                )
            return self._estimate("generalized", [candidates], watch.seconds), None
        if self.ranked is not None:
            return self._estimate("standard", [self.ranked.standard], {}), None
        paper, watch = self._baseline(), Stopwatch()
        first, second = self.features
        prepared = prepare_pair(*self.images, paper, features1=first, features2=second, watch=watch)
        return self._estimate("standard", [standard_set(prepared, paper)], watch.seconds), prepared.features

    def on_ranked(self, found: tuple[Features, Features] | None = None) -> FundamentalEstimate:
        """Return the estimate on ranked matches, of features that were `found` before, if they are at hand."""
        ranked = self.ranked
        if ranked is None:
            first, second = found or self.features
            ranked = rank.rank_matches(*self.images, settings=self.settings, features1=first, features2=second)
        return self._estimate(self.settings.name, ranked.sets, ranked.seconds)

    def cascade(self, rule: CascadeRule) -> FundamentalEstimate:
        """Return the estimate without preprocessing if the rule keeps it, else the one on ranked matches."""
        first, features = self.on_standard()
        if rule.keeps(first):
            return first
        second = self.on_ranked(features)
        best = first if first and not second else second
        return replace(best, seconds={"standard input": sum(first.seconds.values())} | dict(second.seconds))

    def _baseline(self) -> PreprocessSettings:
        """Return the paper's preset on the features that were asked for, normalised as the paper does."""
        paper, own = find_preset("paper"), self.settings.features
        return replace(paper, features=replace(own, root=paper.features.root, centred=paper.features.centred))

    def _estimate(self, kind: str, sets: Sequence[MatchSet], seconds: Mapping[str, float]) -> FundamentalEstimate:
        how = self.hand_over or load_hand_overs()[self.estimator][kind]
        if self.threshold_px is not None:
            how = replace(how, threshold_px=self.threshold_px)
        sizes = sets[0].image_sizes or (_size_of(self.images[0]), _size_of(self.images[1]))
        limit = self.settings.features.max_image_size
        factor1, factor2 = (blank_photograph((round(w), round(h)), limit).factor for w, h in sizes)
        found = estimate_from_matches(
            sets, estimator=self.estimator, seed=self.seed, hand_over=how, pixel_factors=(factor1, factor2)
        )
        message = found.message
        if found.status is Status.TOO_FEW_MATCHES:
            why = explain_shortage(self.images, self.features, self.settings.features)
            message += f"; {why}" if why else ""
        return replace(found, input=kind, message=message, seconds=dict(seconds) | dict(found.seconds))
