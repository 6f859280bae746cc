"""Facts of an estimate: what the matches, F and the best homography say, in numbers that need no truth.

None of them decides anything by itself; the classifiers of `epiprior.verification.confidence` take them together.
Where the two images change places, they hardly change. What is unknown is -1. Lengths are working pixels.
"""

import math
from dataclasses import astuple, dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from epiprior.geometry import first_of_equal, sampson_distance
from epiprior.types import BoolArray, Float32Array, FloatArray, MatchSet
from epiprior.verification import degeneracy, measures, overlay
from epiprior.verification.chance import MATCHES_PER_F, chance_rate, distinct_count, log_chance

UNKNOWN = -1.0
_MATCHES_PER_H = 4
_NEIGHBOURS = 6  # of which a match is its own first
_TOP = (20, 100)


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What is known of one estimate: numbers and lengths as ``log(1 + n)``, probabilities by chance as log10.

    Supporters lie within the threshold of F, *distinct* ones share no point; ``collected`` are the matches over which
    support was collected in the end, ``handed`` those that the estimator was given.
    """

    matches: float  # of the roll hypothesis
    handed: float
    collected: float
    support_handed: float  # distinct supporters among those handed over
    support: float  # and among those collected
    share_handed: float  # of distinct matches that support F
    share: float
    top_20: float  # share of supporters among the first so many matches handed over
    top_100: float
    cells_least: float  # cells of 48 px with supporters, in the image with fewer
    cells_most: float
    extent: float  # side of a square as large as the box around the supporters, in the image where it is smaller
    extent_share: float  # of the side for all matches
    residual: float  # median Sampson distance of the supporters over the threshold
    crowding: float  # share of the matches within three thresholds that lie within one
    oriented: float  # share of the supporters before both cameras together, or behind both
    neighbours: float  # share of supporters among the nearest matches of supporters, in the image where it is lower
    turn: float  # length of the mean of the supporters' turns of orientation, each of length one
    scale: float  # median deviation of the log ratio of their scales
    by_chance_handed: float
    by_chance: float
    rate: float  # of agreement by chance, as log10
    known: float  # whether the matches have probabilities
    probability: float  # mean over the supporters
    explained: float  # sum of log odds (`measures.match_weights`) that agrees with F
    left_over: float  # and that does not
    explained_share: float
    plausibility: float
    rolls: float  # number of roll hypotheses
    rolls_agree: float  # share of the supporters that the other hypothesis' F has too
    beside_line: float  # share of supporters off one line, in the image where it is lower
    moved: float  # median displacement of supporters
    in_place: float  # share of supporters that do not move
    apart: float  # share of supporters apart from what is repeated in place
    plane_tight: float  # share of supporters within the threshold of the best homography
    plane: float  # and within 8/3 of it
    plane_all: float  # share of all collected matches within that
    plane_support: float  # distinct supporters within that
    plane_by_chance: float
    off_plane: float  # supporters beside the plane
    off_plane_by_chance: float
    parallax_by_chance: float
    plane_residual: float  # median distance of supporters near the homography
    relief: float  # distance from it that one in ten supporters exceeds
    copy_residual: float  # distance from the best similarity that one in ten supporters near the homography exceeds
    turn_like: float  # `degeneracy.turn_likeness`

    def row(self) -> Float32Array:
        """Return the numbers in the order of `COLUMNS`, shape (C,), all finite."""
        return np.nan_to_num(np.array(astuple(self), np.float32), nan=UNKNOWN, posinf=1e6, neginf=-1e6)


COLUMNS = tuple(field.name for field in fields(Facts))


def describe_estimate(
    F: FloatArray,
    H: FloatArray | None,
    matches: MatchSet,
    handed: MatchSet,
    collected: MatchSet,
    threshold_px: float,
    others: tuple[FloatArray, ...] = (),
    odds: tuple[MatchSet, FloatArray] | None = None,
) -> Facts:
    """Return the facts of F, shape (3, 3), in working pixels.

    `matches` are those of its roll hypothesis, `handed` and `collected` are as in `Facts`; `H` is the best homography
    of the supporters (`degeneracy.fit_homography`), `others` are the F of the other roll hypotheses, and `odds` is
    `measures.weighed_matches` of `matches`, where that is known.
    """
    x1, x2 = collected.x1, collected.x2
    distance = sampson_distance(F, x1, x2)
    inliers, wide = distance < threshold_px, distance < 3 * threshold_px
    first = sampson_distance(F, handed.x1, handed.x2) < threshold_px
    own = collected.take(inliers)
    total, support = distinct_count(x1, x2), distinct_count(own.x1, own.x2)
    total_handed = distinct_count(handed.x1, handed.x2)
    support_handed = distinct_count(handed.x1[first], handed.x2[first])
    rate = chance_rate(F, x1, x2, threshold_px)
    cells = [len(first_of_equal(np.floor(x / measures.CELL_PX))) for x in (own.x1, own.x2)]
    extents = [(_side(a), _side(b)) for a, b in ((own.x1, x1), (own.x2, x2))]
    agree = [float(np.mean(sampson_distance(o, own.x1, own.x2) < threshold_px)) for o in others if support]
    known = measures.camera_plausibility(F[None], matches.image_sizes)[0] if matches.image_sizes else UNKNOWN
    return Facts(
        matches=math.log1p(len(matches)),
        handed=math.log1p(total_handed),
        collected=math.log1p(total),
        support_handed=math.log1p(support_handed),
        support=math.log1p(support),
        share_handed=support_handed / max(total_handed, 1),
        share=support / max(total, 1),
        **{f"top_{top}": float(np.mean(first[:top])) if len(first) else 0.0 for top in _TOP},
        cells_least=math.log1p(min(cells)),
        cells_most=math.log1p(max(cells)),
        extent=math.log1p(min(a for a, _ in extents)),
        extent_share=min(a / max(b, 1.0) for a, b in extents),
        residual=_median(sampson_distance(F, own.x1, own.x2)) / threshold_px,
        crowding=support / max(distinct_count(x1[wide], x2[wide]), 1),
        oriented=_oriented_share(F, own.x1, own.x2),
        neighbours=min(_share_near(x, inliers) for x in (x1, x2)),
        **_local_agreement(own),
        by_chance_handed=log_chance(support_handed, total_handed, rate, MATCHES_PER_F),
        by_chance=log_chance(support, total, rate, MATCHES_PER_F),
        rate=math.log10(max(rate, 1e-9)),
        **_odds(F, odds or measures.weighed_matches(matches), own, threshold_px),
        plausibility=float(known),
        rolls=1.0 + len(others),
        rolls_agree=max(agree, default=1.0),
        beside_line=min(
            degeneracy.share_beside_line(x, degeneracy.PLANE_FACTOR * threshold_px) for x in (own.x1, own.x2)
        ),
        moved=math.log1p(_median(np.linalg.norm(own.x2 - own.x1, axis=1))),
        in_place=overlay.share_in_place(own.x1, own.x2),
        apart=float(np.mean(overlay.apart_from_overlay(x1, x2)[inliers])) if support else 0.0,
        **_plane(F, H, collected, inliers, total, threshold_px, rate),
    )


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _side(x: FloatArray) -> float:
    return float(np.sqrt(np.prod(np.ptp(x, axis=0)))) if len(x) else 0.0


def _oriented_share(F: FloatArray, x1: FloatArray, x2: FloatArray) -> float:
    """Return for which share of matches the oriented epipolar constraint has one sign (Chum, Werner, Matas, 2004)."""
    if not len(x1):
        return 0.0
    epipole = np.linalg.svd(F)[0][:, 2]
    y1, y2 = (np.column_stack([x, np.ones(len(x))]) for x in (x1, x2))
    positive = float(np.mean((np.cross(epipole, y2) * (y1 @ F.T)).sum(axis=1) > 0))
    return max(positive, 1.0 - positive)


def _share_near(x: FloatArray, inliers: BoolArray) -> float:
    if not inliers.any() or len(x) < 2:
        return 0.0
    near = cKDTree(x).query(x[inliers], min(_NEIGHBOURS, len(x)))[1]
    return float(np.mean(inliers[near[:, 1:]]))


def _local_agreement(own: MatchSet) -> dict[str, float]:
    """Return how alike features of supporters turn and grow; unknown where all have one orientation or scale."""
    turn = np.deg2rad(own.orientation2_deg - own.orientation1_deg)
    growth = np.log(own.scale2 / own.scale1)
    no_turn = not len(own) or (np.ptp(own.orientation1_deg) == 0 and np.ptp(own.orientation2_deg) == 0)
    no_scale = not len(own) or (np.ptp(own.scale1) == 0 and np.ptp(own.scale2) == 0)
    return {
        "turn": UNKNOWN if no_turn else float(np.abs(np.mean(np.exp(1j * turn)))),
        "scale": UNKNOWN if no_scale else float(np.median(np.abs(growth - np.median(growth)))),
    }


def _odds(F: FloatArray, odds: tuple[MatchSet, FloatArray], own: MatchSet, threshold_px: float) -> dict[str, float]:
    """Return what the probabilities of all one-to-one matches say for F, and against it."""
    single, weights = odds
    agrees = sampson_distance(F, single.x1, single.x2) < threshold_px
    known = len(own) > 0 and bool(np.isfinite(own.probability).all())
    total = float(weights.sum())
    return {
        "known": float(known),
        "probability": float(np.mean(own.probability)) if known else UNKNOWN,
        "explained": math.log1p(float(weights[agrees].sum())),
        "left_over": math.log1p(float(weights[~agrees].sum())),
        "explained_share": float(weights[agrees].sum()) / total if total > 0 else 0.0,
    }


def _plane(
    F: FloatArray, H: FloatArray | None, collected: MatchSet, inliers: BoolArray, total: int, px: float, rate: float
) -> dict[str, float]:
    names = COLUMNS[COLUMNS.index("plane_tight") :]
    if H is None:
        return dict.fromkeys(names, UNKNOWN)
    x1, x2 = collected.x1, collected.x2
    distance = degeneracy.homography_distance(H, x1, x2)
    near, wide = distance < degeneracy.PLANE_FACTOR * px, distance[inliers]
    on1, on2 = x1[near], x2[near]
    off, expected = degeneracy.off_plane_evidence(F, H, x1, x2, threshold_px=px, rate=rate)
    parallax, support = degeneracy.parallax_by_chance(F, H, on1, on2), distinct_count(on1, on2)
    return {
        "plane_tight": float(np.mean(wide < px)),
        "plane": float(np.mean(wide < degeneracy.PLANE_FACTOR * px)),
        "plane_all": support / max(total, 1),
        "plane_support": math.log1p(support),
        "plane_by_chance": chance_of_homography(support, total, x2, px),
        "off_plane": math.log1p(off),
        "off_plane_by_chance": math.log10(min(max(expected, 1e-300), 1e9)),
        "parallax_by_chance": math.log10(max(parallax, 1e-300)),
        "plane_residual": _median(distance[near]),
        "relief": math.log1p(min(float(np.quantile(wide, 0.9)), 1e6)),
        "copy_residual": float(np.quantile(np.append(degeneracy.similarity_residuals(on1, on2), 0.0), 0.9)),
        "turn_like": degeneracy.turn_likeness(H, collected.image_sizes),
    }


def chance_of_homography(support: int, total: int, x2: FloatArray, px: float) -> float:
    """Return `log_chance` of `support` of `total` distinct matches on a homography.

    A random match lies on it by the area of its disc among the points `x2`, (N, 2), of image 2.
    """
    radius = degeneracy.PLANE_FACTOR * px
    rate = min(1.0, math.pi * radius**2 / max(_side(x2) ** 2, 1.0))
    return log_chance(support, total, rate, _MATCHES_PER_H)
