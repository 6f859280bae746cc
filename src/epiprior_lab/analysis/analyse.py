"""Which part of the method contributes what, and what limits its results (paper, "Analysis", and beyond).

On some pairs of every group, with several seeds, three experiments. ``steps`` are the paper's figure: standard input,
ranking by 2keypoints, the best single rough F, sfm alone, all measures as printed (`paper`), and beyond it the preset
`default`, also with another estimator (`beyond`). In ``ablation`` the preset `default` has one part replaced; its model
was trained with all parts in place, so each variant is also ranked by sfm alone, which uses no model. ``oracle`` are
runs that know the truth, see `epiprior_lab.analysis.oracles`.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.geometry import sampson_distance
from epiprior.matching.baselines import standard_set
from epiprior.presets import find_preset
from epiprior.ranking.hypothesis import Candidates, cast_votes
from epiprior.ranking.models import load_model
from epiprior.types import FloatArray, MatchSet
from epiprior_lab.analysis import oracles
from epiprior_lab.analysis.records import NO_ESTIMATOR, Analysis, LimitRecord, PrecisionRecord, VariantRecord
from epiprior_lab.analysis.variants import Proposals, oriented_votes, propose, ranked_sets, reordered
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.inputs import PairMatches
from epiprior_lab.evaluation.records import Record
from epiprior_lab.evaluation.runs import HandOvers, estimates
from epiprior_lab.features.detection import detect_pair
from epiprior_lab.labels.ground_truth import error_px, label_matches
from epiprior_lab.measures import average_precision, precision_at
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import TruthParams

_BOTH = ("final", "sfm")  # by the model's probabilities; without a model


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
    whole: tuple[oracles.Labelled, ...]

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
        return error_px(F, *self.points)

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
            score=float("nan") if F is None else max(oracles.score(F, each.matches, each.pixel) for each in self.whole),
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


def analyse_pair(
    *, pair: Pair, group: str, complete: bool, settings: AnalysisSettings, hand_overs: HandOvers, labels: TruthParams
) -> list[Record]:
    """Compare the variants on one pair with control points, and cameras or depths by which matches are labelled.

    Unless `complete`, for easy pairs, where nearly all succeeds: only the steps and X alone, that with all estimators.
    """
    presets = [find_preset(name) for name in ("paper", "default")]
    detected = [detect_pair(pair, preset.features) for preset in presets]
    found = detected[1]
    paper, default = (
        propose(one.photographs, one.features, preset, load_model(preset.model))
        for one, preset in zip(detected, presets, strict=True)
    )
    whole = ranked_sets(default)
    pixel = float(np.sqrt(found.pixel_factors[0] * found.pixel_factors[1]))
    right = [label_matches(pair, m.x1, m.x2, m.scale1, m.scale2, settings=labels) for m in whole]
    bench = Bench(
        group=group,
        pair=pair,
        points=pair.control_points(),
        factors=found.pixel_factors,
        settings=settings,
        hand_overs=hand_overs,
        whole=tuple(oracles.Labelled(matches=m, right=r, pixel=pixel) for m, r in zip(whole, right, strict=True)),
    )
    estimators = (settings.estimator, *(settings.others if complete else ()), settings.beyond)
    ours = {name: list(bench.estimated("oracle", "default", "final", whole, name, "default")) for name in estimators}
    records: list[Record] = [*_steps(bench, paper, () if complete else settings.others)]
    for variant, name in (("default", settings.estimator), ("beyond", settings.beyond)):
        records += [replace(record, experiment="steps", variant=variant) for record in ours[name]]
    for variant, ranking, sets in _ablations(default, whole, settings.two_keypoint_counts if complete else ()):
        ordered = [reordered(each, ranking) for each in sets]
        records.append(bench.precision(variant, ranking, ordered[0]))
        records += bench.estimated("ablation", variant, ranking, ordered, settings.estimator, "default")
    if complete:
        records += _oracles(bench, default, ours)
    return records


def _steps(bench: Bench, paper: Proposals, others: Sequence[str]) -> Iterator[VariantRecord]:
    """Yield the records of the paper's figure; `others` run on sfm alone and on all measures only."""
    main = bench.settings.estimator
    sets = ranked_sets(paper)
    by_sfm = [reordered(each, "sfm") for each in sets]
    standard = standard_set(paper.prepared, paper.settings)
    yield from bench.estimated("steps", "standard", "lowe", [standard], main, "standard")
    by_two = [reordered(each, "2keypoint") for each in sets]
    yield from bench.estimated("steps", "2keypoint", "2keypoint", by_two, main, "paper")
    F, supporters = _largest_support(paper, sets)
    refined = None if F is None else oracles.refine_on_all(F, supporters, bench.whole[0].pixel)
    yield from bench.known("steps", "single F", "none", F)
    yield from bench.known("steps", "single F, refined", "none", refined)
    for estimator in (main, *others):
        yield from bench.estimated("steps", "sfm", "sfm", by_sfm, estimator, "paper")
        yield from bench.estimated("steps", "paper", "final", sets, estimator, "paper")


def _largest_support(proposals: Proposals, sets: Sequence[MatchSet]) -> tuple[FloatArray | None, MatchSet]:
    """Return the rough F that most of X support, over all roll hypotheses, and the set of its roll hypothesis."""
    best, chosen, most = None, sets[0], -1
    for found, matches in zip(proposals.candidates, sets, strict=True):
        # X and the limit are in working pixels, the matrices of the set in given ones.
        D1, D2 = (np.linalg.inv(to_working) for to_working in proposals.prepared.to_working)
        F = D2.T @ matches.rough_matrices @ D1
        x1, x2, limit = found.frames.x1, found.frames.x2, proposals.settings.vote_threshold
        counts = [int(np.count_nonzero(sampson_distance(one, x1, x2) < limit)) for one in F]
        if counts and max(counts) > most:
            most = max(counts)
            best, chosen = matches.rough_matrices[counts.index(most)], matches
    return best, chosen


def _ablations(
    proposals: Proposals, whole: tuple[MatchSet, ...], counts: Sequence[int]
) -> Iterator[tuple[str, str, tuple[MatchSet, ...]]]:
    """Yield variant, ranking and sets of the preset `default`; without `counts` only X alone beside it."""
    settings = proposals.settings
    voters = {
        "one round": (replace(settings, second_round=0), cast_votes),
        "frames of SIFT": (replace(settings, frame="feature"), cast_votes),
        "oriented matches": (settings, oriented_votes),
        **{f"K_2kp {count}": (replace(settings, two_keypoint_count=count), cast_votes) for count in counts},
    }
    yield from (("default", ranking, whole) for ranking in _BOTH)
    # By sfm alone, only matches of X are ranked anyway.
    yield "X alone", "final", ranked_sets(proposals, standard=False)
    for variant, (changed, voter) in voters.items() if counts else ():
        sets = ranked_sets(proposals, changed, voter)
        yield from ((variant, ranking, sets) for ranking in _BOTH)


def _oracles(bench: Bench, proposals: Proposals, ours: Mapping[str, list[VariantRecord]]) -> Iterator[Record]:
    """Yield the runs that know the truth, beside `ours`, which do not, and what the pair allows."""
    for records in ours.values():
        yield from records
    # The hand-over of the probabilities: what changes is their values.
    told = [oracles.labels_first(each) for each in bench.whole]
    for estimator in ours:
        yield from bench.estimated("oracle", "true labels", "final", told, estimator, "default")
    rough, refined, fits, refits, errors = [], [], [], [], []
    for each in bench.whole:
        errors.append(np.array([bench.error_px(F) for F in each.matches.rough_matrices]))
        order = np.argsort(errors[-1], kind="stable")[: bench.settings.refined_hypotheses]
        hypotheses = each.matches.rough_matrices[order]
        rough += list(hypotheses[:1])
        refined += [oracles.refine_on_all(F, each.matches, each.pixel) for F in hypotheses]
        fit = oracles.fit_right(each)
        if fit is not None:
            fits.append(fit)
            refits.append(oracles.refine_on_all(fit, each.matches, each.pixel))
    known = {"right matches": fits, "right matches, refined on all": refits}
    known |= {"best rough F": rough, "best rough F, refined on all": refined}
    for variant, matrices in known.items():
        yield from bench.known("oracle", variant, "final", min(matrices, key=bench.error_px, default=None))
    among_x = [_in_x(proposals, found, each) for found, each in zip(proposals.candidates, bench.whole, strict=True)]
    yield LimitRecord(
        **bench.key,
        matches=max(len(each.matches) for each in bench.whole),
        right_one_to_one=max(len(each.right_one_to_one) for each in bench.whole),
        right_one_to_one_in_x=max(len(each.right_one_to_one) for each in among_x),
        rough_matrices=sum(map(len, errors)),
        good_rough_matrices=sum(int(np.count_nonzero(e < bench.settings.success_px)) for e in errors),
    )


def _in_x(proposals: Proposals, candidates: Candidates, labelled: oracles.Labelled) -> oracles.Labelled:
    """Return the matches of X, without those that only X_L or X_B proposed."""
    X, matches = candidates.X, labelled.matches
    # X counts locations, a set the first feature of each.
    place1, place2 = proposals.prepared.locations
    x1, x2 = place1.first[X.feature1], place2.first[X.feature2]
    width = 1 + int(max(x2.max(initial=0), matches.feature2.max(initial=0)))
    inside = np.isin(matches.feature1 * width + matches.feature2, x1 * width + x2)
    return replace(labelled, matches=matches.take(inside), right=labelled.right[inside])


def analyse_pairs(
    groups: Mapping[str, Sequence[Pair]],
    *,
    complete: Collection[str],
    settings: AnalysisSettings,
    hand_overs: HandOvers,
    labels: TruthParams,
    files: Sequence[Path],
    store: Path,
) -> Analysis:
    """Analyse the pairs of all groups in parallel, those in `complete` completely; a run that was killed continues.

    `files` determine every result beside the pair's own images: the model files. `store` is as for
    `epiprior_lab.compute.tasks.map_tasks`.
    """
    names = (settings.estimator, settings.beyond, *settings.others)
    common = {"settings": settings, "hand_overs": {name: dict(hand_overs[name]) for name in names}, "labels": labels}
    tasks = []
    for group, pairs in groups.items():
        for pair in pairs:
            payload = {"pair": pair, "group": group, "complete": group in complete, **common}
            tasks.append(Task(name=f"{group} {pair.pair_id}", payload=payload, files=(*pair.files, *files)))
    found = map_tasks(analyse_pair, tasks, description="analyse", store=store)
    return Analysis.from_records(record for records in found for record in records)
