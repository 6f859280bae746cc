"""Where the variants of one pair are measured: estimates over seeds, and rankings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from epiprior.types import FloatArray, MatchSet
from epiprior_lab.analysis.oracles import Labelled, score
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.estimates import is_deterministic
from epiprior_lab.evaluation.rankings import ranking_orders
from epiprior_lab.evaluation.statistics import average_precision, precision_at
from epiprior_lab.labels.ground_truth import errors_px
from epiprior_lab.pairsets import Pair

Row = dict[str, Any]
HandOvers = Mapping[str, Mapping[str, HandOver]]

NO_ESTIMATOR = "none"


@dataclass(frozen=True, kw_only=True)
class AnalysisSettings:
    """What is compared.

    Parameters
    ----------
    estimator : str
        The paper's of this analysis, which runs on every variant.
    others : tuple of str
        Run on sfm alone and on all measures of easy pairs, and on probabilities and true labels of the others.
    beyond : str
        The estimator that goes beyond the paper.
    seeds : tuple of int
        Repetitions of every estimate.
    two_keypoint_counts : tuple of int
        K_2kp of the ablation.
    refined_hypotheses : int
        How many of the truly best rough matrices an oracle refines.
    success_px : float
        Error below which a rough matrix counts as good.
    """

    estimator: str = "usac"
    others: tuple[str, ...] = ()
    beyond: str = "epiprior"
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    two_keypoint_counts: tuple[int, ...] = (50, 200)
    refined_hypotheses: int = 20
    success_px: float = 10.0


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Where variants of one pair are measured.

    Parameters
    ----------
    pair : Pair
        Pair with ground truth.
    points : tuple of ndarray, shape (N, 2), float64
        Its control points.
    factors : tuple of float
        Given pixels per working pixel of both images.
    settings : AnalysisSettings
        Estimators and seeds.
    hand_overs : mapping
        ``hand_overs[estimator][input]``.
    whole : tuple of Labelled
        The sets of the preset `default`, by whose probabilities every F is scored.
    """

    pair: Pair
    points: tuple[FloatArray, FloatArray]
    factors: tuple[float, float]
    settings: AnalysisSettings
    hand_overs: HandOvers
    whole: tuple[Labelled, ...]

    def estimated(self, sets: Sequence[MatchSet], estimator: str, kind: str) -> list[Row]:
        """Return a row per seed: what the estimator makes of the sets, measured at F before the verdict.

        Parameters
        ----------
        sets : sequence of MatchSet
            One per roll hypothesis.
        estimator, kind : str
            The hand-over is that of `estimator` for the input `kind`.
        """
        how = self.hand_overs[estimator][kind]
        rows: list[Row] = []
        for seed in self.settings.seeds:
            if rows and is_deterministic(estimator):
                rows.append({**rows[0], "seed": seed})
                continue
            found = estimate_from_matches(
                sets,
                estimator=estimator,
                seed=child_seed(seed, self.pair.pair_id),
                hand_over=how,
                pixel_factors=self.factors,
            )
            rows.append(self._row(estimator, seed, found.raw_F, str(found.status)))
        return rows

    def known(self, F: FloatArray | None) -> list[Row]:
        """Return a row per seed, all alike, for a matrix that no estimator chose."""
        status = "no_model" if F is None else "ok"
        return [self._row(NO_ESTIMATOR, seed, F, status) for seed in self.settings.seeds]

    def score(self, F: FloatArray | None) -> float:
        """Return the support of F among the matches, weighted by their probabilities; NaN without F."""
        return float("nan") if F is None else max(score(F, each.matches, each.pixel) for each in self.whole)

    def error_px(self, F: FloatArray | None) -> float:
        """Return the mean Sampson distance of the control points, the paper's measure; NaN without F."""
        return float("nan") if F is None else float(errors_px(F, *self.points).mean())

    def _row(self, estimator: str, seed: int, F: FloatArray | None, status: str) -> Row:
        row = {"estimator": estimator, "seed": seed, "status": status}
        return {**row, "error_px": self.error_px(F), "score": self.score(F)}

    def precision(self, matches: MatchSet, ranking: str) -> Row:
        """Return the precision of one ranking of a set, whose matches are among those of the preset `default`."""
        ranked = matches.take(ranking_orders(matches)[ranking])
        right = self.whole[0].right_of(ranked)
        return {
            "matches": len(right),
            "right": int(np.count_nonzero(right)),
            "precision_10": precision_at(right, 10),
            "precision_100": precision_at(right, 100),
            "average_precision": average_precision(right),
        }
