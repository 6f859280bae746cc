"""Where the variants of one pair are measured: estimates over seeds, and rankings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from epiprior.types import FloatArray, MatchSet
from epiprior_lab.analysis.oracles import Labelled, score
from epiprior_lab.analysis.records import NO_ESTIMATOR, PrecisionRecord, VariantRecord
from epiprior_lab.evaluation.inputs import PairMatches
from epiprior_lab.evaluation.runs import HandOvers, estimates
from epiprior_lab.labels.ground_truth import errors_px
from epiprior_lab.measures import average_precision, precision_at
from epiprior_lab.pairsets import Pair


@dataclass(frozen=True, kw_only=True)
class AnalysisSettings:
    """What is compared.

    `estimator` runs on every variant; `others` on sfm alone and on all measures of easy pairs, and on probabilities and
    true labels of the others; `beyond` goes beyond the paper. `two_keypoint_counts` are K_2kp of the ablation. An
    oracle refines `refined_hypotheses` of the truly best rough matrices; good ones have an error below `success_px`.
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

    `points` are its control points, (N, 2) twice, pixels; `factors` given pixels per working pixel of both images; the
    hand-overs ``hand_overs[estimator][input]``. `whole` are the sets of the preset `default`, by whose probabilities
    every F is scored.
    """

    group: str
    pair: Pair
    points: tuple[FloatArray, FloatArray]
    factors: tuple[float, float]
    settings: AnalysisSettings
    hand_overs: HandOvers
    whole: tuple[Labelled, ...]

    @property
    def key(self) -> dict[str, Any]:
        """What leads every record."""
        return {"group": self.group, "pair_id": self.pair.pair_id, "scene": self.pair.scene}

    def estimated(
        self, experiment: str, variant: str, ranking: str, sets: Sequence[MatchSet], estimator: str, kind: str
    ) -> Iterator[VariantRecord]:
        """Yield a record per seed: what the estimator makes of the sets, handed over as those of the input `kind`."""
        matches = PairMatches(sets={kind: tuple(sets)}, pixel_factors=self.factors)
        how, seeds = self.hand_overs[estimator], self.settings.seeds
        for _, seed, found in estimates(matches, self.pair.pair_id, estimator=estimator, seeds=seeds, hand_overs=how):
            yield self._record(experiment, variant, ranking, estimator, seed, found.F, str(found.status))

    def known(self, experiment: str, variant: str, ranking: str, F: FloatArray | None) -> Iterator[VariantRecord]:
        """Yield a record per seed, all alike, for a matrix that no estimator chose."""
        for seed in self.settings.seeds:
            yield self._record(experiment, variant, ranking, NO_ESTIMATOR, seed, F, "no_model" if F is None else "ok")

    def error_px(self, F: FloatArray | None) -> float:
        """Return the mean Sampson distance of the control points, the paper's measure; NaN without F."""
        return float("nan") if F is None else float(errors_px(F, *self.points).mean())

    def _record(
        self, experiment: str, variant: str, ranking: str, estimator: str, seed: int, F: FloatArray | None, status: str
    ) -> VariantRecord:
        return VariantRecord(
            **self.key,
            experiment=experiment,
            variant=variant,
            ranking=ranking,
            estimator=estimator,
            seed=seed,
            status=status,
            error_px=self.error_px(F),
            score=float("nan") if F is None else max(score(F, each.matches, each.pixel) for each in self.whole),
        )

    def precision(self, variant: str, ranking: str, ordered: MatchSet) -> PrecisionRecord:
        """Return the precision of an ordered set, whose matches are among those of the first set of `whole`."""
        right = self.whole[0].right_of(ordered.one_to_one())
        return PrecisionRecord(
            **self.key,
            variant=variant,
            ranking=ranking,
            matches=len(right),
            right=int(np.count_nonzero(right)),
            precision_10=precision_at(right, 10),
            precision_100=precision_at(right, 100),
            average_precision=average_precision(right),
        )
