"""The estimator ``epiprior``: it starts from what the preprocessing left behind, and draws nothing by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.estimators.epiprior_evidence import Evidence, match_weights, prior_probability, voice
from epiprior.estimators.epiprior_kernels import refine_models
from epiprior.estimators.epiprior_plane import plane_and_parallax
from epiprior.estimators.epiprior_proposals import fit_samples, oriented_pairs, progressive_rows
from epiprior.estimators.packages import package_version
from epiprior.estimators.protocol import EstimatorSettings, RawModel
from epiprior.geometry import MIN_MATCHES, sampson_distance
from epiprior.selection import one_to_one_mask
from epiprior.types import FloatArray, MatchSet

# Thresholds in units of the inlier threshold: 1.5 px give 10, 8, 6, 4, 3, 2, 2, 1.5, 1.5.
_SHRINKING = np.array([20 / 3, 16 / 3, 4.0, 8 / 3, 2.0, 4 / 3, 4 / 3, 1.0, 1.0])
_COARSE, _FINE, _RIVAL, _PLANE = 4.0, 4 / 3, 2.0, 8 / 3
_MIN_DISTANCE_PX = 30.0


@dataclass(frozen=True, kw_only=True)
class EpipriorEstimator:
    """Rough matrices, two oriented matches and samples of the ranking: scored, refined, and held against rivals.

    Parameters
    ----------
    max_iterations : int
        Samples of eight matches from the head of the ranking.
    head : int
        So many one-to-one matches choose and refine hypotheses.
    kept_rough, kept_other : int
        So many of the rough matrices, and of each other source, are refined: no source crowds out another.
    finalists : int
        So many of the refined are judged by all matches and their rivals.
    oriented : int
        Every two of so many best matches give a hypothesis.
    mended, plane_matches : int
        So many of the best are tested for a dominant plane, and so many matches off it try its epipole.

    Notes
    -----
    Deterministic: the seed changes nothing.
    """

    name: str = "epiprior"
    licence: str = "BSD-3-Clause"
    max_iterations: int = 3_000
    head: int = 800
    kept_rough: int = 200
    kept_other: int = 60
    finalists: int = 200
    oriented: int = 80
    mended: int = 5
    plane_matches: int = 40

    def missing(self) -> str:
        """Return an empty string: it is always there."""
        return ""

    def version(self) -> str:
        """Return epiprior's version."""
        return package_version("epiprior")

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Return the best supported F; `seed` changes nothing."""
        del seed
        single = matches.one_to_one().take(slice(self.head))
        if len(single) < MIN_MATCHES:
            return RawModel(F=None)
        search = _Search.of(matches, single, settings.threshold_px)
        sources = self._proposals(single, settings)
        kept = (self.kept_rough, self.kept_other, self.kept_other)
        starts = [search.likeliest(models, count, _COARSE) for models, count in zip(sources, kept, strict=True)]
        found = search.likeliest(search.refined(np.concatenate(starts)), self.finalists, _FINE)
        leaders = search.most_telling(found, self.mended)
        planar = np.concatenate([np.empty((0, 3, 3)), *(self._mended(F, single, search.px) for F in leaders)])
        mended = search.refined(search.likeliest(planar, self.kept_other, _COARSE))
        leaders = search.most_telling(np.concatenate([leaders, mended]), self.mended)
        polished = np.concatenate([search.polished(F) for F in leaders]) if len(leaders) else leaders
        best = search.most_telling(np.concatenate([leaders, polished]), 1)
        tried = sum(map(len, sources)) + len(planar)
        return RawModel(F=best[0] if len(best) else None, iterations=tried)

    def _proposals(self, single: MatchSet, settings: EstimatorSettings) -> tuple[FloatArray, FloatArray, FloatArray]:
        samples = settings.max_iterations or self.max_iterations
        drawn = fit_samples(single.x1, single.x2, progressive_rows(len(single), samples))
        return single.rough_matrices, oriented_pairs(single, self.oriented, _MIN_DISTANCE_PX), drawn

    def _mended(self, F: FloatArray, single: MatchSet, px: float) -> FloatArray:
        return plane_and_parallax(
            F, single.x1, single.x2, threshold_px=px, plane_px=_PLANE * px, count=self.plane_matches
        )


@dataclass(frozen=True, kw_only=True)
class _Search:
    """The matches of one call, arranged for choosing, refining and judging models."""

    matches: MatchSet
    weights: FloatArray
    single: MatchSet
    probability: FloatArray
    px: float
    likely: Evidence
    telling: tuple[Evidence, Evidence]

    @classmethod
    def of(cls, matches: MatchSet, single: MatchSet, px: float) -> _Search:
        probability = prior_probability(single)
        weights = match_weights(matches, prior_probability(matches))
        features = (matches.feature1, matches.feature2)
        first, second = (Evidence.of(matches.x1, matches.x2, weights, feature) for feature in features)
        return cls(
            matches=matches,
            weights=weights,
            single=single,
            probability=probability,
            px=px,
            likely=Evidence.of(single.x1, single.x2, probability, np.arange(len(single))),
            telling=(first, second),
        )

    def likeliest(self, models: FloatArray, count: int, threshold: float) -> FloatArray:
        """Return the models that the probabilities of one-to-one matches speak for most."""
        return _best(models, self.likely.scores(models, threshold * self.px), count)

    def most_telling(self, models: FloatArray, count: int) -> FloatArray:
        """Return the models that all matches speak for and their rivals do not."""
        first, second = (side.scores(models, _FINE * self.px, _RIVAL * self.px) for side in self.telling)
        return _best(models, first + second, count)

    def refined(self, models: FloatArray) -> FloatArray:
        """Return the models after probability-weighted eight-point fits over shrinking thresholds."""
        models = np.ascontiguousarray(models).copy()
        refine_models(models, self.single.x1, self.single.x2, self.probability, _SHRINKING * self.px)
        return models

    def polished(self, F: FloatArray) -> FloatArray:
        """Return F refined, (1, 3, 3), on the telling ones of all matches that agree with it, one-to-one."""
        m = self.matches
        distance = sampson_distance(F, m.x1, m.x2)
        agrees = distance < _RIVAL * self.px
        share = voice(m.feature1, agrees) * voice(m.feature2, agrees)
        rows = np.flatnonzero(distance < _PLANE * self.px)
        weights = (self.weights * share)[rows]
        rows = rows[np.argsort(-weights * (1.0 - (distance[rows] / (_PLANE * self.px)) ** 2), kind="stable")]
        rows = rows[one_to_one_mask(m.feature1[rows], m.feature2[rows])]
        model = F[None].copy()
        refine_models(model, m.x1[rows], m.x2[rows], (self.weights * share)[rows], _SHRINKING[3:] * self.px)
        return model


def _best(models: FloatArray, scores: FloatArray, count: int) -> FloatArray:
    order = np.argsort(-scores, kind="stable")[:count]
    return models[order[scores[order] > 0]]


ESTIMATORS = (EpipriorEstimator(),)
