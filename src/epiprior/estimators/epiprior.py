"""The estimator ``epiprior``: it starts from what the preprocessing left behind, and asks for a plausible camera."""

import numpy as np

from epiprior.estimators.protocol import Estimator
from epiprior.geometry import MIN_MATCHES, Evidence, as_columns, different_models, sampson_distance, with_three_around
from epiprior.kernels.local_steps import climb, refine_models
from epiprior.kernels.parallel import in_chunks
from epiprior.kernels.samples import generator_state
from epiprior.kernels.solvers import fit_samples
from epiprior.types import FloatArray, IntArray, MatchSet
from epiprior.verification.degeneracy import fit_homography, homography_distance
from epiprior.verification.measures import SpreadEvidence

# Thresholds in units of the inlier threshold: 1.5 px give 10, 8, 6, 4, 3, 2, 2, 1.5, 1.5.
_SHRINKING = np.array([20 / 3, 16 / 3, 4.0, 8 / 3, 2.0, 4 / 3, 4 / 3, 1.0, 1.0])
_CLIMBING = np.array([2.0, 4 / 3, 1.0, 1.0])
_COARSE, _FINE, _NEAR, _PLANE, _AROUND = 4.0, 4 / 3, 2.0, 8 / 3, 16 / 3
_HEAD = 800  # so many one-to-one matches choose and refine hypotheses
_KEPT = (200, 60, 60)  # so many of the rough matrices are refined, and so many of each other source
_ORIENTED, _MIN_DISTANCE_PX = 80, 30.0  # every two of so many best matches, so far apart, give a hypothesis
_PLANE_MATCHES = 40  # the best hypothesis is tested for a dominant plane, and so many matches off it give epipoles
_LEADERS = 8  # so many different ones of the best are optimised,
_INNER_SAMPLES = 30  # by so many inner samples each
_SAME_SHARE = 0.75  # two hypotheses are the same from this intersection over union of their supporters on
_FRAME_RADIUS, _SAMPLE_SIZE = 6.0, 8
_SAMPLES_STATE, _STATE = 20140, 20141  # of generators
_REFINED, _FITTED = 20, 512  # models that a thread refines, or fits, at a time


def search(matches: MatchSet, threshold_px: float, cap: int, seed: int) -> tuple[FloatArray | None, int | None]:
    """Return the best supported F; `cap` is of samples of eight matches, `seed` changes nothing.

    Rough matrices, two oriented matches and samples of the ranking are scored, refined and optimised. Every choice
    among refined hypotheses follows one score: what the matches say, each part of the images once, times the
    plausibility of the cameras (`epiprior.verification.measures`). Local optimisation of one hypothesis climbs its
    first factor alone.
    """
    del seed
    found, px = _Search(matches, threshold_px), threshold_px
    head = found.head
    if len(head) < MIN_MATCHES:
        return None, None
    drawn = fit_all(as_columns(head.x1, head.x2), progressive_rows(len(head), cap))
    sources = (head.rough_matrices, oriented_pairs(head, _ORIENTED, _MIN_DISTANCE_PX), drawn)
    kept = [found.likeliest(models, count) for models, count in zip(sources, _KEPT, strict=True)]
    refined = found.refined(np.concatenate(kept))
    planar = [
        plane_and_parallax(F, head.x1, head.x2, threshold_px=px, plane_px=_PLANE * px, count=_PLANE_MATCHES)
        for F in found.best(refined, 1)
    ]
    through_plane = np.concatenate([np.empty((0, 3, 3)), *planar])
    refined = np.concatenate([refined, found.refined(found.likeliest(through_plane, _KEPT[-1]))])
    leaders = found.best(refined, _LEADERS, _SAME_SHARE)
    best = found.best(np.concatenate([leaders, found.optimised(leaders)]), 1)
    return best[0] if len(best) else None, sum(map(len, sources)) + len(through_plane)


class _Search:
    """The one-to-one matches of one call, arranged for choosing, refining and judging models."""

    def __init__(self, matches: MatchSet, px: float) -> None:
        self.evidence, self.px = SpreadEvidence(matches), px
        self.single, self.prior = self.evidence.single, self.evidence.prior
        self.head = self.single.take(slice(_HEAD))
        self.likely = Evidence(self.head.x1, self.head.x2, self.prior[:_HEAD])

    def likeliest(self, models: FloatArray, count: int) -> FloatArray:
        """Return the rough models with the highest sums of probabilities of the head."""
        scores = self.likely.scores(models, _COARSE * self.px)
        order = np.argsort(-scores, kind="stable")[:count]
        return models[order[scores[order] > 0]]

    def best(self, models: FloatArray, count: int, same_share: float = 1.0) -> FloatArray:
        """Return the models with the highest scores, best first, no two of which have the same supporters."""
        scores = self.evidence.scores(models, _FINE * self.px)
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

    def optimised(self, models: FloatArray) -> FloatArray:
        """Return the models after local optimisation of what the matches say for them."""
        models = np.ascontiguousarray(models).copy()
        evidence, order = self.evidence, np.argsort(self.evidence.group, kind="stable")

        def work(part: slice) -> None:
            F = models[part.start]
            rows = order[sampson_distance(F, self.single.x1, self.single.x2)[order] < _AROUND * self.px]
            columns = as_columns(self.single.x1[rows], self.single.x2[rows])
            climb(
                F, columns, self.prior[rows], evidence.weights[rows], evidence.group[rows], _FINE * self.px,
                _CLIMBING * self.px, _NEAR * self.px, _INNER_SAMPLES, generator_state(_STATE),
            )  # fmt: skip

        in_chunks(work, len(models), 1)
        return models


def oriented_pairs(matches: MatchSet, count: int, min_distance_px: float) -> FloatArray:
    """Return an F, shape (P, 3, 3), for every two of the best `count` matches that lie far enough apart in both images.

    Matches are one-to-one. Eight-point estimates from each match and three points around it, by the scale and
    orientation of its features. BEEM-style, our interpretation of Goshen and Shimshoni, TPAMI 2008: three points at
    angles 120 degrees apart, six sigma away.
    """
    head = matches.take(slice(count))
    i, j = np.triu_indices(len(head), 1)
    far = np.all([np.linalg.norm(x[i] - x[j], axis=1) >= min_distance_px for x in (head.x1, head.x2)], axis=0)
    corners = 4 * np.column_stack([np.repeat(i[far, None], 4, axis=1), np.repeat(j[far, None], 4, axis=1)])
    rows = corners + np.tile(np.arange(4), 2)
    y1 = with_three_around(head.x1, _FRAME_RADIUS * head.scale1, np.deg2rad(head.orientation1_deg))
    y2 = with_three_around(head.x2, _FRAME_RADIUS * head.scale2, np.deg2rad(head.orientation2_deg))
    return fit_all(as_columns(y1.reshape(-1, 2), y2.reshape(-1, 2)), rows)


def fit_all(columns: FloatArray, rows: IntArray) -> FloatArray:
    """Return the eight-point F of each row of `rows` (S, K) into the matches (4, N): shape (S, 3, 3)."""
    models = np.empty((len(rows), 3, 3))

    def work(part: slice) -> None:
        models[part] = fit_samples(columns, rows[part])

    in_chunks(work, len(rows), _FITTED)
    return models


def progressive_rows(matches: int, samples: int) -> IntArray:
    """Return samples of eight matches, (samples, 8), from heads of the ranking that grow from the best to all.

    The head grows by the same factor from sample to sample (after the schedule of PROSAC, at a pace of our own).
    """
    head = np.geomspace(min(2 * _SAMPLE_SIZE, matches), matches, samples).astype(np.int64)
    rows = np.empty((samples, _SAMPLE_SIZE), np.int64)
    draws = np.random.default_rng(_SAMPLES_STATE).random((samples, _SAMPLE_SIZE))
    for k in range(_SAMPLE_SIZE):
        # The k-th draw among the rows that are left: skip those drawn before, in increasing order.
        row = (draws[:, k] * (head - k)).astype(np.int64)
        for earlier in np.sort(rows[:, :k], axis=1).T:
            row += row >= earlier
        rows[:, k] = row
    return rows


def plane_and_parallax(
    F: FloatArray, x1: FloatArray, x2: FloatArray, *, threshold_px: float, plane_px: float, count: int
) -> FloatArray:
    """Mend an F whose support lies on one plane: that plane with the epipole of every two matches off it.

    Returns ``[e']x H``, shape (P, 3, 3), of the best `count` one-to-one matches that lie `plane_px` or more off the
    homography H; none where no plane holds half of the support of `F`.

    References: Chum, Werner and Matas, Two-view geometry estimation unaffected by a dominant plane, CVPR 2005; Hartley
    and Zisserman, algorithm 13.2. That every two matches are tried, in place of samples, is ours.
    """
    support = sampson_distance(F, x1, x2) < threshold_px
    H = fit_homography(x1[support], x2[support], plane_px)
    if H is None:
        return np.empty((0, 3, 3))
    on_plane = homography_distance(H, x1, x2) < plane_px
    if np.count_nonzero(on_plane & support) < 0.5 * np.count_nonzero(support):
        return np.empty((0, 3, 3))
    off = np.flatnonzero(~on_plane)[:count]
    return models_of_plane(H, x1[off], x2[off])


def models_of_plane(H: FloatArray, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Return ``[e']x H`` for the epipole e' at which the parallaxes of every two of the matches off a plane meet.

    `H` is the homography of the plane, ``x2 ~ H x1``.
    """
    ones = np.ones((len(x1), 1))
    # The line through where the plane would have put a point and where it is holds the epipole.
    lines = np.cross(np.hstack([x1, ones]) @ H.T, np.hstack([x2, ones]))
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-300)
    i, j = np.triu_indices(len(x1), 1)
    epipoles = np.cross(lines[i], lines[j])
    length = np.linalg.norm(epipoles, axis=1)
    e = epipoles[length > 0] / length[length > 0, None]
    S = np.zeros((len(e), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -e[:, 2], e[:, 1], -e[:, 0]
    models = (S - np.swapaxes(S, 1, 2)) @ (H / np.linalg.norm(H))
    return np.asarray(models / np.maximum(np.linalg.norm(models, axis=(1, 2), keepdims=True), 1e-300))


ESTIMATORS = (Estimator(name="epiprior", run=search, max_iterations=3_000, deterministic=True),)
