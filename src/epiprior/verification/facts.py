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
from epiprior.verification import degeneracy
from epiprior.verification.chance import MATCHES_PER_F, chance_rate, distinct_count, log_chance
from epiprior.verification.measures import CELL_PX, SpreadEvidence, camera_plausibility

UNKNOWN = -1.0
_MATCHES_PER_H = 4
_NEIGHBOURS = 6  # of which a match is its own first
_TOP = (20, 100)
_SAME_PX = 1.0
_RING_PX = (2.0, 5.0)
_MIN_REPEATED = 3


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
    evidence: SpreadEvidence,
    handed: MatchSet,
    collected: MatchSet,
    threshold_px: float,
    others: tuple[FloatArray, ...] = (),
) -> Facts:
    """Return the facts of F, shape (3, 3), in working pixels.

    `evidence` is of the matches of its roll hypothesis, `handed` and `collected` are as in `Facts`; `H` is the best
    homography of the supporters (`degeneracy.fit_homography`), `others` are the F of the other roll hypotheses.
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
    cells = [len(first_of_equal(np.floor(x / CELL_PX))) for x in (own.x1, own.x2)]
    extents = [(_side(a), _side(b)) for a, b in ((own.x1, x1), (own.x2, x2))]
    agree = [float(np.mean(sampson_distance(o, own.x1, own.x2) < threshold_px)) for o in others if support]
    sizes = evidence.matches.image_sizes
    return Facts(
        matches=math.log1p(len(evidence.matches)),
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
        **_odds(F, evidence, own, threshold_px),
        plausibility=float(camera_plausibility(F[None], sizes)[0]) if sizes else UNKNOWN,
        rolls=1.0 + len(others),
        rolls_agree=max(agree, default=1.0),
        beside_line=min(
            degeneracy.share_beside_line(x, degeneracy.PLANE_FACTOR * threshold_px) for x in (own.x1, own.x2)
        ),
        moved=math.log1p(_median(np.linalg.norm(own.x2 - own.x1, axis=1))),
        in_place=share_in_place(own.x1, own.x2),
        apart=float(np.mean(apart_from_overlay(x1, x2)[inliers])) if support else 0.0,
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


def _odds(F: FloatArray, evidence: SpreadEvidence, own: MatchSet, threshold_px: float) -> dict[str, float]:
    """Return what the probabilities of all one-to-one matches say for F, and against it."""
    single, weights = evidence.single, evidence.weights
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


def share_in_place(x1: FloatArray, x2: FloatArray) -> float:
    """Return which share of matches (N, 2) stays in place, within 1 px; 0 without matches."""
    return float(np.mean(np.linalg.norm(x2 - x1, axis=1) <= _SAME_PX)) if len(x1) else 0.0


def apart_from_overlay(x1: FloatArray, x2: FloatArray) -> BoolArray:
    """Return which matches, shape (N, 2), working pixels, lie elsewhere than on an overlay: all, where there is none.

    An overlay does not move with the scene: a watermark, also a tiled one, a time stamp, the bars of a screen. Two
    unrelated photographs that carry the same match there, feature by feature. Any F of a pure translation explains
    matches that stay in place, and one along its epipolar lines those from tile to tile; the two numbers that are left
    are fitted to chance. COLMAP calls such pairs watermarks, where the matches are a translation at the border.

    There is an overlay where at least 3 matches stay in place, within 1 px, and more than are displaced by 2 to 5 px:
    displacements of a scene are spread out, those of an overlay are not. All displacements that are as frequent and as
    isolated count as the overlay's. Matches of which both ends lie within 48 px of it say nothing about the scene.
    """
    moved = x2 - x1
    length = np.linalg.norm(moved, axis=1)
    still = np.count_nonzero(length <= _SAME_PX)
    around = np.count_nonzero((length > _RING_PX[0]) & (length <= _RING_PX[1]))
    if still < _MIN_REPEATED or still <= around:
        return np.ones(len(x1), np.bool_)
    tree = cKDTree(moved)
    same, inner, outer = (tree.query_ball_point(moved, px, return_length=True) for px in (_SAME_PX, *_RING_PX))
    repeated = (same >= _MIN_REPEATED) & (same > outer - inner)
    overlay = cKDTree(np.vstack([x1[repeated], x2[repeated]]))
    return np.asarray(np.maximum(overlay.query(x1)[0], overlay.query(x2)[0]) > CELL_PX)
