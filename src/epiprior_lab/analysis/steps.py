"""Which part of the method contributes what, and what limits its results (paper, "Analysis", and beyond).

On some pairs of a family, with several seeds:

``steps``
    The paper's figure: standard input, ranking by 2keypoints, the best single rough F, sfm alone, all measures as
    printed (`paper`), and ours beyond it (`default`, and `default` with another estimator).
``ablation``
    The preset `default` with one part replaced. Its model was trained with all parts in place; so each variant is also
    ranked by sfm alone, where no model judges matches.
``oracle``
    Runs that know the truth, see `epiprior_lab.analysis.oracles`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from epiprior.matching.baselines import standard_set
from epiprior.presets import find_preset
from epiprior.ranking.hypothesis import Candidates, cast_votes
from epiprior.ranking.models import load_model
from epiprior.types import BoolArray, FloatArray, MatchSet
from epiprior_lab.analysis import oracles
from epiprior_lab.analysis.bench import AnalysisSettings, Bench, HandOvers, Row
from epiprior_lab.analysis.variants import Proposals, oriented_votes, propose, ranked_sets, reordered, supports
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.evaluation.estimates import write_rows
from epiprior_lab.features.detection import detect_pair
from epiprior_lab.labels.ground_truth import LabelSettings, label_matches
from epiprior_lab.pairsets import Pair

WITHOUT_MODEL = "sfm"  # the ranking that no model judges


@dataclass(frozen=True, kw_only=True)
class PairAnalysis:
    """Rows of one pair, or of many after `join`; each field becomes one CSV file of its name.

    Parameters
    ----------
    results : list of dict
        One row per experiment, variant, ranking, estimator and seed.
    rankings : list of dict
        Precision of each variant's rankings.
    limits : list of dict
        What the pair's matches and hypotheses allow.
    """

    results: list[Row]
    rankings: list[Row]
    limits: list[Row]

    @classmethod
    def join(cls, parts: Sequence[PairAnalysis]) -> PairAnalysis:
        """Return the rows of all `parts`, in their order."""
        return cls(**{f.name: [row for part in parts for row in getattr(part, f.name)] for f in fields(cls)})

    def write(self, folder: Path) -> None:
        """Write one CSV file per field to `folder`, made if absent."""
        for f in fields(self):
            write_rows(getattr(self, f.name), folder / f"{f.name}.csv")


def analyse_pair(
    *,
    pair: Pair,
    family: str,
    complete: bool,
    settings: AnalysisSettings,
    hand_overs: HandOvers,
    labels: LabelSettings,
) -> PairAnalysis:
    """Compare the variants on one pair.

    Parameters
    ----------
    pair : Pair
        Pair with control points, and cameras or depths by which matches are labelled.
    family : str
        Name of the pair set; it leads every row, followed by pair id and scene.
    complete : bool
        False: for easy pairs, on which nearly everything succeeds. Only the steps and X alone, the latter with all
        estimators.
    settings, hand_overs
        As for `Bench`.
    labels : LabelSettings
        When a match counts as right.
    """
    found = detect_pair(pair)
    paper, default = (
        propose(found.photographs, found.features, find_preset(name), load_model(name)) for name in ("paper", "default")
    )
    whole = ranked_sets(default)
    pixel = float(np.sqrt(found.pixel_factors[0] * found.pixel_factors[1]))
    bench = Bench(
        pair=pair,
        points=pair.control_points(),
        factors=found.pixel_factors,
        settings=settings,
        hand_overs=hand_overs,
        whole=tuple(oracles.Labelled(matches=s, right=_right(pair, s, labels), pixel=pixel) for s in whole),
    )
    key = {"family": family, "pair_id": pair.pair_id, "scene": pair.scene}
    estimators = (settings.estimator, *(settings.others if complete else ()), settings.beyond)
    ours = {name: bench.estimated(whole, name, "default") for name in estimators}
    others = () if complete else settings.others
    results = [{**key, "experiment": "steps", **row} for row in _steps(bench, paper, ours, others)]
    rankings: list[Row] = []
    for variant, ranking, sets in _ablations(default, whole, settings.two_keypoint_counts if complete else ()):
        names = {"variant": variant, "ranking": ranking}
        rankings.append({**key, **names, **bench.precision(sets[0], ranking)})
        ordered = [reordered(s, ranking) for s in sets]
        rows = bench.estimated(ordered, settings.estimator, "default")
        results += [{**key, "experiment": "ablation", **names, **row} for row in rows]
    limits: list[Row] = []
    if complete:
        oracle, limit = _oracles(bench, default, ours)
        results += [{**key, "experiment": "oracle", **row} for row in oracle]
        limits.append({**key, **limit})
    return PairAnalysis(results=results, rankings=rankings, limits=limits)


def _right(pair: Pair, m: MatchSet, labels: LabelSettings) -> BoolArray:
    return label_matches(pair, m.x1, m.x2, m.scale1, m.scale2, settings=labels)


def _steps(bench: Bench, paper: Proposals, ours: Mapping[str, list[Row]], others: Sequence[str]) -> Iterator[Row]:
    """Yield the rows of the paper's figure; `others` run on sfm alone and on all measures only.

    `ours` holds what each estimator makes of the preset `default`.
    """
    settings = bench.settings
    sets = ranked_sets(paper)
    standard = standard_set(paper.prepared, paper.settings)

    def rows(variant: str, ranking: str, found: list[Row]) -> Iterator[Row]:
        yield from ({"variant": variant, "ranking": ranking, **row} for row in found)

    yield from rows("standard", "lowe", bench.estimated([standard], settings.estimator, "standard"))
    for ranking in ("2keypoint", "sfm"):
        ordered = [reordered(s, ranking) for s in sets]
        yield from rows(ranking, ranking, bench.estimated(ordered, settings.estimator, "paper"))
    F, supporters = _largest_support(paper, sets)
    yield from rows("single F", "none", bench.known(F))
    refined = None if F is None else oracles.refine_on_all(F, supporters, bench.whole[0].pixel)
    yield from rows("single F, refined", "none", bench.known(refined))
    yield from rows("paper", "final", bench.estimated(sets, settings.estimator, "paper"))
    yield from rows("default", "final", ours[settings.estimator])
    yield from rows("beyond", "final", ours[settings.beyond])
    for other in others:
        ordered = [reordered(s, "sfm") for s in sets]
        yield from rows("sfm", "sfm", bench.estimated(ordered, other, "paper"))
        yield from rows("paper", "final", bench.estimated(sets, other, "paper"))


def _largest_support(proposals: Proposals, sets: Sequence[MatchSet]) -> tuple[FloatArray | None, MatchSet]:
    """Return the rough F that most of X support, over all roll hypotheses, and the set of its hypothesis."""
    best, chosen, most = None, sets[0], -1
    for found, matches in zip(proposals.candidates, sets, strict=True):
        # X and the limit are in working pixels, the matrices of the set in given ones.
        D1, D2 = (np.linalg.inv(to_working) for to_working in proposals.prepared.to_working)
        F = D2.T @ matches.rough_matrices @ D1
        counts = supports(F, found.frames.x1, found.frames.x2, proposals.settings.vote_threshold)
        if len(counts) and counts.max() > most:
            most = int(counts.max())
            best, chosen = matches.rough_matrices[counts.argmax()], matches
    return best, chosen


def _ablations(
    proposals: Proposals, whole: tuple[MatchSet, ...], counts: Sequence[int]
) -> Iterator[tuple[str, str, tuple[MatchSet, ...]]]:
    """Yield variant, ranking and sets of the preset `default`; without `counts` only X alone beside it."""
    settings = proposals.settings
    votes = {
        "frames of SIFT": (replace(settings, frame="feature"), cast_votes),
        "oriented matches": (settings, oriented_votes),
        **{f"K_2kp {count}": (replace(settings, two_keypoint_count=count), cast_votes) for count in counts},
    }
    for ranking in ("final", WITHOUT_MODEL):
        yield "default", ranking, whole
    # By sfm alone, only matches of X are ranked anyway.
    yield "X alone", "final", ranked_sets(proposals, standard=False)
    for variant, (changed, voter) in votes.items() if counts else ():
        sets = ranked_sets(proposals, changed, voter)
        for ranking in ("final", WITHOUT_MODEL):
            yield variant, ranking, sets


def _oracles(bench: Bench, proposals: Proposals, ours: Mapping[str, list[Row]]) -> tuple[list[Row], Row]:
    """Return the rows of the runs that know the truth, beside `ours`, which do not, and what the pair allows."""
    settings = bench.settings
    rows: list[Row] = [{"variant": "default", **row} for found in ours.values() for row in found]
    # The hand-over of the probabilities: what changes is what they say.
    told = [oracles.labels_first(each) for each in bench.whole]
    for estimator in ours:
        rows += [{"variant": "true labels", **row} for row in bench.estimated(told, estimator, "default")]
    rough, refined, fits, refits = [], [], [], []
    for each in bench.whole:
        hypotheses, _ = oracles.best_hypotheses(each, bench.points, settings.refined_hypotheses)
        rough += list(hypotheses[:1])
        refined += [oracles.refine_on_all(F, each.matches, each.pixel) for F in hypotheses]
        fit = oracles.fit_right(each)
        fits += [] if fit is None else [fit]
        refits += [] if fit is None else [oracles.refine_on_all(fit, each.matches, each.pixel)]
    best = {
        "right matches": _truly_best(bench, fits),
        "right matches, refined on all": _truly_best(bench, refits),
        "best rough F": _truly_best(bench, rough),
        "best rough F, refined on all": _truly_best(bench, refined),
    }
    for name, F in best.items():
        rows += [{"variant": name, **row} for row in bench.known(F)]
    among_x = [_in_x(proposals, found, each) for found, each in zip(proposals.candidates, bench.whole, strict=True)]
    limit = {
        "matches": max(len(each.matches) for each in bench.whole),
        "right_one_to_one": max(len(each.right_one_to_one) for each in bench.whole),
        "right_one_to_one_in_x": max(len(each.right_one_to_one) for each in among_x),
        "rough_matrices": sum(len(each.matches.rough_matrices) for each in bench.whole),
        "good_rough_matrices": _good_rough(bench),
    }
    return [{"ranking": "final", **row} for row in rows], limit


def _truly_best(bench: Bench, matrices: Sequence[FloatArray]) -> FloatArray | None:
    return min(matrices, key=bench.error_px, default=None)


def _good_rough(bench: Bench) -> int:
    """Return how many rough matrices have a true error that counts as a success."""
    errors = [oracles.mean_errors_px(each.matches.rough_matrices, *bench.points) for each in bench.whole]
    return sum(int(np.count_nonzero(e < bench.settings.success_px)) for e in errors)


def _in_x(proposals: Proposals, candidates: Candidates, labelled: oracles.Labelled) -> oracles.Labelled:
    """Return the matches of X, without those that only X_L or X_B proposed."""
    X, matches = candidates.X, labelled.matches
    # X counts locations, a set the first feature of each.
    x1, x2 = (
        place.first[rows] for place, rows in zip(proposals.prepared.locations, (X.feature1, X.feature2), strict=True)
    )
    width = 1 + int(max(x2.max(initial=0), matches.feature2.max(initial=0)))
    inside = np.isin(matches.feature1 * width + matches.feature2, x1 * width + x2)
    return replace(labelled, matches=matches.take(inside), right=labelled.right[inside])


def analyse_pairs(
    families: Mapping[str, Sequence[Pair]],
    *,
    complete: Collection[str],
    settings: AnalysisSettings,
    hand_overs: HandOvers,
    labels: LabelSettings,
    files: Sequence[Path] = (),
    workers: int = 1,
    store: Path | None = None,
) -> PairAnalysis:
    """Analyse many pairs in parallel; a run that was killed continues.

    Parameters
    ----------
    families : mapping of str to sequence of Pair
        Pairs of each family.
    complete : collection of str
        The families that are analysed completely.
    settings, hand_overs, labels
        As for `analyse_pair`.
    files : sequence of Path
        What decides every pair beside its own images: the model files.
    workers, store
        As for `epiprior_lab.compute.tasks.map_tasks`.
    """
    names = (settings.estimator, settings.beyond, *settings.others)
    common = {
        "settings": settings,
        "hand_overs": {name: dict(hand_overs[name]) for name in names},
        "labels": labels,
    }
    tasks = [
        Task(
            name=f"{family} {pair.pair_id}",
            payload={"pair": pair, "family": family, "complete": family in complete, **common},
            files=(*pair.files, *files),
        )
        for family, pairs in families.items()
        for pair in pairs
    ]
    return PairAnalysis.join(map_tasks(analyse_pair, tasks, workers=workers, description="analyse", store=store))
