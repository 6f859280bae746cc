"""The estimator ``epiprior``: it starts from what the preprocessing left behind, and asks for a plausible camera."""

from dataclasses import dataclass

import numpy as np

from epiprior.estimators.proposals import fit_all, oriented_pairs, plane_and_parallax, progressive_rows
from epiprior.estimators.protocol import Estimator, EstimatorSettings, RawModel
from epiprior.geometry import MIN_MATCHES, Evidence, as_columns, different_models, sampson_distance
from epiprior.kernels.compilation import announce_compilation
from epiprior.kernels.local_steps import climb, refine_models
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.samples import generator_state
from epiprior.types import FloatArray, MatchSet
from epiprior.verification.measures import camera_plausibility, match_weights, prior_probability, spread_groups

# Thresholds in units of the inlier threshold: 1.5 px give 10, 8, 6, 4, 3, 2, 2, 1.5, 1.5.
_SHRINKING = np.array([20 / 3, 16 / 3, 4.0, 8 / 3, 2.0, 4 / 3, 4 / 3, 1.0, 1.0])
_CLIMBING = np.array([2.0, 4 / 3, 1.0, 1.0])
_COARSE, _FINE, _NEAR, _PLANE, _AROUND = 4.0, 4 / 3, 2.0, 8 / 3, 16 / 3
_MIN_DISTANCE_PX = 30.0
_STATE = 20141
_REFINED = 20  # models that a thread refines at a time


@dataclass(frozen=True, kw_only=True)
class EpipriorEstimator(Estimator):
    """Rough matrices, two oriented matches and samples of the ranking: scored, refined, optimised.

    Every choice among refined hypotheses follows one score: what the matches say, each part of the images once
    (`epiprior.estimators.evidence`), times the plausibility of the cameras (`epiprior.verification.measures`). Local
    optimisation of one hypothesis climbs its first factor alone. Deterministic: the seed changes nothing.
    """

    name: str = "epiprior"
    max_iterations: int = 3_000  # samples of eight matches from the head of the ranking
    head: int = 800  # so many one-to-one matches choose and refine hypotheses
    kept_rough: int = 200  # so many of the rough matrices are refined,
    kept_other: int = 60  # and so many of each other source: no source displaces another
    oriented: int = 80  # every two of so many best matches give a hypothesis
    mended: int = 1  # so many of the best hypotheses are tested for a dominant plane,
    plane_matches: int = 40  # and so many matches off it give epipoles
    leaders: int = 8  # so many different ones of the best are optimised,
    inner_samples: int = 30  # by so many inner samples each
    same_share: float = 0.75  # two hypotheses are the same from this intersection over union of their supporters on
    deterministic: bool = True

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Return the best supported F; `seed` changes nothing."""
        del seed
        single = matches.one_to_one()
        if len(single) < MIN_MATCHES:
            return RawModel(F=None)
        announce_compilation(climb, "the estimator epiprior", "about ten seconds")
        search = _Search(single, self.head, settings.threshold_px)
        head, px, samples = search.head, search.px, settings.max_iterations or self.max_iterations
        drawn = fit_all(as_columns(head.x1, head.x2), progressive_rows(len(head), samples))
        sources = (head.rough_matrices, oriented_pairs(head, self.oriented, _MIN_DISTANCE_PX), drawn)
        kept = (self.kept_rough, self.kept_other, self.kept_other)
        found = search.refined(
            np.concatenate([search.likeliest(models, count) for models, count in zip(sources, kept, strict=True)])
        )
        planar = [
            plane_and_parallax(F, head.x1, head.x2, threshold_px=px, plane_px=_PLANE * px, count=self.plane_matches)
            for F in search.best(found, self.mended)
        ]
        through_plane = np.concatenate([np.empty((0, 3, 3)), *planar])
        found = np.concatenate([found, search.refined(search.likeliest(through_plane, self.kept_other))])
        leaders = search.best(found, self.leaders, self.same_share)
        climbed = np.concatenate([leaders, search.optimised(leaders, self.inner_samples)])
        best = search.best(climbed, 1)
        tried = sum(map(len, sources)) + len(through_plane)
        return RawModel(F=best[0] if len(best) else None, iterations=tried)


class _Search:
    """The one-to-one matches of one call, arranged for choosing, refining and judging models."""

    def __init__(self, single: MatchSet, head: int, px: float) -> None:
        self.single, self.head, self.px = single, single.take(slice(head)), px
        self.prior = prior_probability(single)
        self.weights = match_weights(single, self.prior)
        self.group = spread_groups(single.x1, single.x2)
        self.likely = Evidence(self.head.x1, self.head.x2, self.prior[:head])
        self.spread = Evidence(single.x1, single.x2, self.weights, self.group)

    def likeliest(self, models: FloatArray, count: int) -> FloatArray:
        """Return the rough models with the highest sums of probabilities of the head."""
        scores = self.likely.scores(models, _COARSE * self.px)
        order = np.argsort(-scores, kind="stable")[:count]
        return models[order[scores[order] > 0]]

    def best(self, models: FloatArray, count: int, same_share: float = 1.0) -> FloatArray:
        """Return the models with the highest scores, best first, no two of which have the same supporters."""
        scores = self.spread.scores(models, _FINE * self.px) * camera_plausibility(models, self.single.image_sizes)
        order = np.argsort(-scores, kind="stable")
        distances = ((k, sampson_distance(models[k], self.head.x1, self.head.x2)) for k in order[scores[order] > 0])
        supporters = ((int(k), distance < _NEAR * self.px) for k, distance in distances)
        return models[different_models(supporters, count, same_share)]

    def refined(self, models: FloatArray) -> FloatArray:
        """Return the models after probability-weighted eight-point fits over shrinking thresholds."""
        models = np.ascontiguousarray(models).copy()
        columns, prior, thresholds = as_columns(self.head.x1, self.head.x2), self.prior[: len(self.head)], _SHRINKING
        in_chunks(lambda part: refine_models(models[part], columns, prior, thresholds * self.px), len(models), _REFINED)
        return models

    def optimised(self, models: FloatArray, samples: int) -> FloatArray:
        """Return the models after local optimisation of what the matches say for them."""
        models = np.ascontiguousarray(models).copy()
        order = np.argsort(self.group, kind="stable")

        def work(part: slice) -> None:
            F = models[part.start]
            rows = order[sampson_distance(F, self.single.x1, self.single.x2)[order] < _AROUND * self.px]
            columns = as_columns(self.single.x1[rows], self.single.x2[rows])
            climb(
                F, columns, self.prior[rows], self.weights[rows], self.group[rows], _FINE * self.px,
                _CLIMBING * self.px, _NEAR * self.px, samples, generator_state(_STATE),
            )  # fmt: skip

        in_chunks(work, len(models), 1)
        return models


ESTIMATORS = (EpipriorEstimator(),)
