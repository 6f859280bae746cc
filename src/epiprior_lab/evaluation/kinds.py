"""Pairs of every kind that a confidence has to tell apart: planned, made, estimated.

A *place* is a set of photographs that may show the same things; photographs of different places share nothing. True
pairs have the kind ``pair``; the others are made of their images by code, see `epiprior_lab.scenes.kinds`, or rendered:
``doppelganger``, two different facades in one style.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from epiprior.estimators.run import estimate_from_matches
from epiprior.features.images import read_image
from epiprior.types import FundamentalEstimate, Geometry, MatchSet, Status
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.inputs import FIRST, PREPROCESSED, PairMatches, match_detected
from epiprior_lab.evaluation.records import CASCADE, KindRecord
from epiprior_lab.evaluation.runs import HandOvers, each_run, said
from epiprior_lab.evaluation.truth import pair_truth
from epiprior_lab.features.detection import detect_images
from epiprior_lab.labels.ground_truth import error_px
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import TruthParams
from epiprior_lab.scenes.kinds import make_views
from epiprior_lab.scenes.pairs import render_doppelgangers
from epiprior_lab.scenes.world import Image

TRUE, DOPPELGANGER, COLMAP = "pair", "doppelganger", "colmap-verification"
_OF_TWO = ("unrelated", "overlay")
_STYLES = "facades-hard"
_SHIFT = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # to COLMAP's pixels
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class KindCase:
    """One pair of a kind, made of `images` or with a truth of its own; `block` is what cross-validation keeps whole."""

    name: str
    block: str
    kind: str
    seed: int
    images: tuple[Path, Path] | None = None
    pair: Pair | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the pair is made of."""
        return self.pair.files if self.pair is not None else (self.images or ())


def plan_cases(
    places: Mapping[str, Sequence[Pair]], counts: Mapping[str, int], *, block: str, seed: int
) -> list[KindCase]:
    """Return pairs of kinds, so many of each, made of the images of `places`; no two have the same images and kind.

    Fewer where there are no more different ones. True pairs, kind `TRUE`, are spread over the places.
    """
    names = sorted(places)
    cases: list[KindCase] = []
    for kind, count in counts.items():
        rng = np.random.default_rng(child_seed(seed, block, kind))
        seen: set[tuple[str, ...]] = set()
        for _ in range(20 * count):
            if len(seen) == count:
                break
            chosen = rng.choice(len(names), 2, replace=False) if kind in _OF_TWO else rng.integers(len(names), size=1)
            pairs = [places[names[k]][int(rng.integers(len(places[names[k]])))] for k in chosen]
            views = [(pair.image1, pair.image2)[int(rng.integers(2))] for pair in pairs]
            key = (pairs[0].pair_id,) if kind == TRUE else tuple(sorted(map(str, views)))
            if key in seen and kind != DOPPELGANGER:
                continue
            name = f"{kind}-{block}-{len(seen):03d}"
            seen.add((name,) if kind == DOPPELGANGER else key)
            true, rendered = kind == TRUE, kind in (TRUE, DOPPELGANGER)
            images, pair = None if rendered else (views[0], views[-1]), pairs[0] if true else None
            own = child_seed(seed, name)
            cases.append(KindCase(name=name, block=block, kind=kind, seed=own, images=images, pair=pair))
    return cases


def places_of(sets: Mapping[str, Sequence[Pair]], *, by_scene: bool) -> dict[str, list[Pair]]:
    """Return the places of pair sets: scenes where each is a place of its own, else whole sets.

    Sets of photographs come from different places; their scenes may overlap.
    """
    places: dict[str, list[Pair]] = {}
    for name, pairs in sets.items():
        for pair in pairs:
            places.setdefault(pair.scene if by_scene else name, []).append(pair)
    return places


def case_images(case: KindCase) -> tuple[Image, Image]:
    """Return the two images of a case, (H, W, 3), RGB."""
    if case.pair is not None:
        return _read(case.pair.image1), _read(case.pair.image2)
    if case.images is None:
        return render_doppelgangers(_STYLES, case.seed)
    return make_views(case.kind, (_read(case.images[0]), _read(case.images[1])), case.seed)


def _read(path: Path) -> Image:
    return np.asarray(cv2.cvtColor(read_image(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), np.uint8)


def case_runs(
    run: Callable[..., Result], case: KindCase, inputs: Mapping[str, Sequence[str]], hand_overs: HandOvers
) -> tuple[PairMatches, list[tuple[str, str, Result]]]:
    """Match a case in every way that an estimator asks for; return that, and estimator, input and outcome of each run.

    `inputs` are per estimator; `run` is as in `each_run`.
    """
    asked = tuple(dict.fromkeys(name for names in inputs.values() for name in names))
    matches = match_detected(detect_images(*case_images(case)), asked)
    found = []
    for estimator, names in inputs.items():
        own = replace(matches, sets={name: matches.sets[name] for name in names})
        runs = each_run(run, own, case.name, estimator=estimator, seeds=(0,), hand_overs=hand_overs[estimator])
        found += [(estimator, name, outcome) for name, _, outcome in runs]
    return matches, found


def case_records(
    *,
    case: KindCase,
    group: str,
    inputs: Mapping[str, Sequence[str]],
    hand_overs: HandOvers,
    truth: TruthParams,
    rule: CascadeRule,
    cascaded: Sequence[str],
) -> list[KindRecord]:
    """Return one record per estimator and input of a case, and one of COLMAP's own verification of matches.

    The estimators `cascaded` also have one of the cascade by the `rule`.
    """
    known = None if case.pair is None else pair_truth(case.pair, truth)
    matches, runs = case_runs(estimate_from_matches, case, inputs, hand_overs)
    by = {(estimator, name): one for estimator, name, one in runs}
    found = [*runs, *((e, CASCADE, rule.choose(by[e, FIRST], by[e, PREPROCESSED])) for e in cascaded)]
    if "snn" in matches.sets:
        found.append((COLMAP, "snn", _colmap(matches.sets["snn"][0], case.seed)))
    # Errors are meant at working size; control points are given pixels.
    unit = max(matches.pixel_factors)
    about: dict[str, Any] = {"group": group, "pair_id": case.name, "scene": case.block, "kind": case.kind}
    return [
        KindRecord(
            **about,
            estimator=estimator,
            input=name,
            **said(one),
            error_px=float("nan") if known is None else error_px(one.F, known.x1, known.x2) / unit,
        )
        for estimator, name, one in found
    ]


def _colmap(given: MatchSet, seed: int) -> FundamentalEstimate:
    """Return what COLMAP's verification says of matches; support counts only where it gives an F."""
    import pycolmap

    assert given.image_sizes is not None
    cameras = []
    for width, height in given.image_sizes:
        size = (round(width), round(height))
        cameras.append(pycolmap.Camera.create(0, pycolmap.CameraModelId.SIMPLE_RADIAL, 1.2 * max(size), *size))
    rows = np.column_stack([np.arange(len(given))] * 2).astype(np.uint32)
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed % 2**31
    first, second = given.x1 + 0.5, given.x2 + 0.5
    answer = pycolmap.estimate_two_view_geometry(cameras[0], first, cameras[1], second, rows, options)
    kinds = pycolmap.TwoViewGeometryConfiguration
    general = answer.config in (kinds.CALIBRATED, kinds.UNCALIBRATED)
    flat = answer.config in (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)
    inliers = np.zeros(len(given), np.bool_)
    inliers[np.asarray(answer.inlier_matches, np.int64).reshape(-1, 2)[:, 0]] = general or flat
    return FundamentalEstimate(
        status=Status.OK if general else Status.DEGENERATE if flat else Status.NO_MODEL,
        F=None if not general or answer.F is None else _SHIFT.T @ np.asarray(answer.F) @ _SHIFT,
        x1=given.x1,
        x2=given.x2,
        inliers=inliers,
        support=int(inliers.sum()) if general else 0,
        geometry=Geometry.GENERAL if general else Geometry.PLANAR if flat else Geometry.NONE,
        estimator=COLMAP,
    )
