"""Inputs of estimators that are not ranked: X_L, mutual nearest neighbours, candidates of generalised RANSAC."""

from dataclasses import replace

import numpy as np

from epiprior.features.describe import normalise_descriptors
from epiprior.features.images import View
from epiprior.matching.pair import PreparedPair, in_other_order, prepare_pair
from epiprior.matching.standard import Neighbours, mutual_mask, nearest_neighbours, similarity_weights
from epiprior.presets import DEFAULT, PAPER, FeatureSettings, PreprocessSettings
from epiprior.types import Features, Float32Array, FloatArray, IntArray, MatchSet

_BLOCK = 512
_NCC, _CANDIDATES, _RIGHT_SHARE = 0.85, 5, 0.5  # of `generalized_matches`


def _unranked(prepared: PreparedPair, rows: IntArray, to: IntArray, similarity: FloatArray) -> MatchSet:
    """Return matches of the features `rows` of image 1 with `to` of image 2, in that order, without probabilities."""
    f1, f2 = prepared.features
    nearest = prepared.forward.nearest[rows] == to
    weights = similarity_weights(prepared.forward, prepared.backward)
    matches = prepared.matches_of(
        rows,
        to,
        orientation1_deg=f1.orientation_deg[rows],
        orientation2_deg=f2.orientation_deg[to],
        probability=np.full(len(rows), np.nan),
        supporting_matrices=np.zeros(len(rows), np.int64),
        distance_ratio=np.where(nearest, prepared.forward.distance_ratio[rows], 1.0),
        similarity_weight=np.where(nearest, weights[rows], 0.0),
        similarity=similarity,
        two_keypoint_probability=np.zeros(len(rows)),
    )
    return prepared.as_given(matches)


def _nearest(prepared: PreparedPair, rows: IntArray) -> MatchSet:
    forward = prepared.forward
    return _unranked(prepared, rows, forward.nearest[rows], forward.best[rows].astype(np.float64))


def standard_set(prepared: PreparedPair, settings: PreprocessSettings = DEFAULT) -> MatchSet:
    """Return X_L as a `MatchSet`, ordered by distance ratio."""
    ratio = prepared.forward.distance_ratio
    keep = np.flatnonzero((prepared.forward.nearest >= 0) & (ratio <= settings.max_distance_ratio))
    return _nearest(prepared, keep[np.argsort(ratio[keep], kind="stable")])


def standard_matches(
    image1: View | None,
    image2: View | None,
    *,
    features: FeatureSettings = PAPER.features,
    max_distance_ratio: float = PAPER.max_distance_ratio,
    features1: Features | None = None,
    features2: Features | None = None,
) -> MatchSet:
    """Return X_L, the standard matches of the paper, ordered by distance ratio: the baseline (section 4.1).

    Parameters
    ----------
    image1, image2 : The photographs; None only where features are handed in.
    features : The paper's by default: plain SIFT, normalised cross-correlation.
    max_distance_ratio : Matches with a higher d_r are left out.
    features1, features2 : Used instead of detected ones, descriptors as SIFT gives them; `features` says how they are
        normalised.
    """
    settings = replace(PAPER, features=features, max_distance_ratio=max_distance_ratio)
    prepared = prepare_pair(image1, image2, settings, features1=features1, features2=features2, ordered=True)
    return standard_set(prepared, settings)


def snn_features(features: FeatureSettings) -> FeatureSettings:
    """Return settings that find the same features, with descriptors as `snn_matches` takes them: RootSIFT."""
    return replace(features, root=True, centred=False)


def snn_matches(
    image1: View | None,
    image2: View | None,
    *,
    features: FeatureSettings = DEFAULT.features,
    max_distance_ratio: float = 0.85,
    features1: Features | None = None,
    features2: Features | None = None,
) -> MatchSet:
    """Return mutual nearest neighbours of RootSIFT below a ratio, ordered by it: the strongest simple baseline.

    Images and features are as for `standard_matches`; `features` says how they are found. Matches below
    `max_distance_ratio` are kept, a ratio of Euclidean distances of the descriptors, as users of this baseline compute
    it.
    """
    settings = replace(DEFAULT, features=snn_features(features))
    prepared = prepare_pair(image1, image2, settings, features1=features1, features2=features2, ordered=True)
    return snn_set(prepared, max_distance_ratio)


def snn_set(prepared: PreparedPair, max_distance_ratio: float = 0.85) -> MatchSet:
    """Return `snn_matches` of a pair that was prepared with `snn_features`."""
    forward, ratio = prepared.forward, _euclidean_ratio(prepared.forward)
    keep = np.flatnonzero(mutual_mask(forward, prepared.backward) & (ratio < max_distance_ratio))
    rows = keep[np.argsort(ratio[keep], kind="stable")]
    return replace(_nearest(prepared, rows), distance_ratio=ratio[rows])


def _euclidean_ratio(nearest: Neighbours) -> FloatArray:
    """Return the ratio of the distances of unit descriptors to the nearest and to the second; 1 where both vanish."""
    distance, distance2 = (np.sqrt(np.maximum(2 - 2 * s.astype(np.float64), 0)) for s in (nearest.best, nearest.second))
    return np.divide(distance, distance2, out=np.ones_like(distance), where=distance2 > 0)


def snn_of_largest(
    features1: Features,
    features2: Features,
    *,
    largest: int,
    features: FeatureSettings = DEFAULT.features,
    max_distance_ratio: float = 0.85,
) -> MatchSet:
    """Return those of `snn_matches` between the `largest` features of both images, in a fraction of the time.

    Large features are few, and are often found again in other photographs (Wu, 3DV 2013). The nearest neighbours are
    found among these, and must then hold among all: on repeated structure the rival of a match may be a smaller one.
    """
    settings, turned = replace(DEFAULT, features=snn_features(features)), in_other_order(features1, features2)
    whole = (features2, features1) if turned else (features1, features2)
    rows = [np.sort(np.argsort(-one.scale, kind="stable")[:largest]) for one in whole]
    some = [one.take(own) for one, own in zip(whole, rows, strict=True)]
    prepared = prepare_pair(None, None, settings, features1=some[0], features2=some[1])
    all1, all2 = (normalise_descriptors(one.descriptors, root=True, centred=False) for one in whole)
    forward, backward = prepared.forward, prepared.backward
    near1 = np.flatnonzero(mutual_mask(forward, backward) & (_euclidean_ratio(forward) < max_distance_ratio))
    near2 = forward.nearest[near1]
    back, _ = nearest_neighbours(prepared.descriptors[1][near2], all1)
    there, _ = nearest_neighbours(prepared.descriptors[0][near1], all2)
    forward = _updated(forward, near1, there, rows[1][near2])
    backward = _updated(backward, near2, back, rows[0][near1])
    found = snn_set(replace(prepared, forward=forward, backward=backward), max_distance_ratio)
    found = replace(found, feature1=rows[0][found.feature1], feature2=rows[1][found.feature2])
    return found.swapped() if turned else found


def _updated(some: Neighbours, rows: IntArray, among_all: Neighbours, expected: IntArray) -> Neighbours:
    """Return neighbours whose similarities of some rows are those among all; a ratio of 1 where another is nearer."""
    nearest, best, second = some.nearest.copy(), some.best.copy(), some.second.copy()
    same = among_all.nearest == expected
    best[rows], second[rows] = among_all.best, np.where(same, among_all.second, among_all.best)
    nearest[rows[~same]] = -1
    return Neighbours(nearest, best, second)


def generalized_matches(
    image1: View | None,
    image2: View | None,
    *,
    features: FeatureSettings = PAPER.features,
    features1: Features | None = None,
    features2: Features | None = None,
) -> MatchSet:
    """Return all matches above a similarity, many-to-many, each at a low probability: input of generalised RANSAC.

    The method is that of Zhang and Kosecka (Generalized RANSAC framework for relaxed correspondence problems, 3DPVT
    2006) as the paper sums it up (section 2); how the probabilities are shared is our interpretation. Images and
    features are as for `standard_matches`.

    Returns
    -------
    Matches of a normalised cross-correlation of at least 0.85; of the candidates of a feature, in either image, the
    five most similar (this limit is ours: without it two brick walls give millions). `probability` is ``0.5 / max(c1,
    c2)``, where c1 and c2 count the candidates of the two features: that one of them is right is even odds. Sorted by
    it, then by similarity. `distance_ratio` is 1 except for nearest neighbours.
    """
    settings = replace(PAPER, features=features)
    prepared = prepare_pair(image1, image2, settings, features1=features1, features2=features2, ordered=True)
    return generalized_set(prepared)


def generalized_set(prepared: PreparedPair) -> MatchSet:
    """Return `generalized_matches` of a pair that was prepared with the paper's descriptors."""
    rows, to, similarity = _candidates(*prepared.descriptors, _NCC, _CANDIDATES)
    found = _unranked(prepared, rows, to, similarity)
    rivals1, rivals2 = (np.bincount(f, minlength=1)[f] for f in (found.feature1, found.feature2))
    probability = _RIGHT_SHARE / np.maximum(rivals1, rivals2)
    order = np.lexsort((to, rows, -similarity, -probability))
    return replace(found, probability=probability).take(order)


def _candidates(
    d1: Float32Array, d2: Float32Array, threshold: float, limit: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the pairs of descriptors above a similarity that are among the `limit` most similar on both sides."""
    if not len(d1) or not len(d2):
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    found = []
    for first in range(0, len(d1), _BLOCK):
        S = d1[first : first + _BLOCK] @ d2.T
        row, column = np.nonzero(threshold <= S)
        found.append((row + first, column, S[row, column].astype(np.float64)))
    rows, to, similarity = (np.concatenate(part) for part in zip(*found, strict=True))
    keep = (_place_within(rows, to, similarity) < limit) & (_place_within(to, rows, similarity) < limit)
    return rows[keep], to[keep], similarity[keep]


def _place_within(group: IntArray, other: IntArray, similarity: FloatArray) -> IntArray:
    """Return the place, from 0, of each pair among those of its group, most similar first."""
    order = np.lexsort((other, -similarity, group))
    ordered = group[order]
    place = np.empty(len(group), np.int64)
    place[order] = np.arange(len(group)) - np.searchsorted(ordered, ordered)
    return place
