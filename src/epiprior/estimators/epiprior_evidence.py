"""What the matches say for a fundamental matrix: the score of the estimator ``epiprior``.

Why not the sum of the probabilities alone: on repeated structure, an F whose epipolar lines run along the rows of a
facade agrees with every match of a window to any window of its row, right or wrong, and collects more support than the
true F. But it also agrees with the rivals: with the other candidates of the same features, of which at most one can be
right. A match tells for F what its rivals do not. They are the pair's own null model, and it is there without any
further computation, because the preprocessing keeps many-to-many matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epiprior.estimators.epiprior_kernels import score_models
from epiprior.refine import SCORE_THRESHOLD_PX
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray, MatchSet

CHANCE = 0.02
LENIENCE = 0.3
WITHOUT_RATIO = 0.5
RIVAL_FACTOR = 1.5


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Weighted matches, arranged for scoring many F.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float32
        Matches, pixels from `centre1` and `centre2`, sorted by feature.
    weights : ndarray, shape (N,), float32
        What a match is worth at distance zero.
    feature : ndarray, shape (N,), int64
        Of the matches of one feature only the best counts.
    rivals : ndarray, shape (N,), float32
        How many other matches the feature of each has.
    centre1, centre2 : ndarray, shape (2,), float64
        Means of the points: single precision is then exact enough.
    """

    x1: Float32Array
    x2: Float32Array
    weights: Float32Array
    feature: IntArray
    rivals: Float32Array
    centre1: FloatArray
    centre2: FloatArray

    @classmethod
    def of(cls, x1: FloatArray, x2: FloatArray, weights: FloatArray, feature: IntArray) -> Evidence:
        """Arrange N matches with their weights and the features that they compete for."""
        order = np.argsort(feature, kind="stable")
        _, place, counts = np.unique(feature[order], return_inverse=True, return_counts=True)
        centre1, centre2 = (x.mean(axis=0) if len(x) else np.zeros(2) for x in (x1, x2))
        return cls(
            x1=(x1 - centre1)[order].astype(np.float32),
            x2=(x2 - centre2)[order].astype(np.float32),
            weights=weights[order].astype(np.float32),
            feature=np.asarray(place, dtype=np.int64),
            rivals=(counts[place] - 1).astype(np.float32),
            centre1=centre1,
            centre2=centre2,
        )

    def scores(self, models: FloatArray, threshold_px: float, rival_px: float | None = None) -> FloatArray:
        """Return the score of each of `models` (K, 3, 3), in [0, sum of the weights]: shape (K,), float64.

        A feature whose best match has weight w and Sampson distance r says w (1 - r^2 / threshold^2), nothing beyond
        the threshold, times ``(1 - a / (n + 0.3))^3`` where a of the n rivals lie within `rival_px` (the threshold, by
        default).
        """
        found = np.zeros(len(models), np.float32)
        if len(models) and len(self.x1):
            columns = _centred_columns(models, self.centre1, self.centre2)
            threshold_sq, rival_sq = np.float32(threshold_px**2), np.float32((rival_px or threshold_px) ** 2)
            matches = (self.x1, self.x2, self.weights, self.feature, self.rivals)
            score_models(columns, *matches, threshold_sq, rival_sq, np.float32(LENIENCE), found)
        return np.nan_to_num(found.astype(np.float64), nan=0.0)


def telling_score(F: FloatArray, matches: MatchSet, threshold_px: float = SCORE_THRESHOLD_PX) -> float:
    """Return how much the matches say for one F, over the features of both images.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
        Fundamental matrix.
    matches : MatchSet
        Many-to-many as they are; without rivals this is a weighted sum with a truncated loss.
    threshold_px : float
        Sampson distance at which a match says nothing; rivals agree within 1.5 times as much.

    Returns
    -------
    float
        >= 0. It may be compared between roll hypotheses of one pair.
    """
    weights = match_weights(matches, prior_probability(matches))
    sides = (Evidence.of(matches.x1, matches.x2, weights, f) for f in (matches.feature1, matches.feature2))
    return float(sum(side.scores(F[None], threshold_px, RIVAL_FACTOR * threshold_px)[0] for side in sides))


def match_weights(matches: MatchSet, probability: FloatArray) -> FloatArray:
    """Return what each match is worth: the log of how much likelier it makes an F that it agrees with.

    A match of probability p agrees with a wrong F at the rate of chance c, here 0.02: ``log(1 + p / ((1 - p) c))``.
    Matches without a distance ratio, which only clusters propose, count half: what speaks for them are mostly the votes
    of the rough matrices, and these would be heard twice.
    """
    p = np.clip(probability, 0.0, 1.0 - 1e-6)
    worth = np.log1p(p / ((1.0 - p) * CHANCE))
    return np.where(matches.distance_ratio < 1.0, worth, WITHOUT_RATIO * worth)


def voice(feature: IntArray, agrees: BoolArray) -> FloatArray:
    """Return what the rivals of one image leave of each match's voice, in [0, 1]: see `Evidence.scores`."""
    _, place = np.unique(feature, return_inverse=True)
    count, agreeing = np.bincount(place), np.bincount(place, weights=agrees)
    others = np.maximum(agreeing[place] - agrees, 0.0)
    return np.asarray((1.0 - others / (count[place] - 1 + LENIENCE)).clip(0.0) ** 3)


def prior_probability(matches: MatchSet) -> FloatArray:
    """Return the probability of each match; where it has none, one from its distance ratio.

    The ratio's log odds are a line, fitted by eye to matches of rendered scenes: even odds at a ratio of 0.65.
    """
    known = matches.probability
    guessed = 1.0 / (1.0 + np.exp(13.0 * (matches.distance_ratio - 0.65)))
    return np.clip(np.where(np.isnan(known), guessed, known), 0.0, 1.0)


def _centred_columns(models: FloatArray, centre1: FloatArray, centre2: FloatArray) -> Float32Array:
    """Return the models about the two centres, each at a size of about one, as (9, K)."""
    T1, T2 = np.eye(3), np.eye(3)
    T1[:2, 2], T2[:2, 2] = centre1, centre2
    G = T2.T @ models @ T1
    size = np.abs(G).max(axis=(1, 2), keepdims=True)
    G = G / (np.abs(G[:, :2, :2]).max(axis=(1, 2), keepdims=True) + 1e-9 * size + 1e-300)
    return np.ascontiguousarray(G.reshape(-1, 9).T, dtype=np.float32)
