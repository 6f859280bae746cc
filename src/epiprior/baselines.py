"""The inputs that estimators get without us: X_L as in the paper, and the strongest simple pipeline of today."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from epiprior.features import FeatureSettings, Image
from epiprior.pair import PreparedPair, prepare_pair
from epiprior.presets import DEFAULT, PreprocessSettings, find_preset
from epiprior.standard import mutual_mask, similarity_weights
from epiprior.types import IntArray, MatchSet


def standard_set(prepared: PreparedPair, settings: PreprocessSettings = DEFAULT) -> MatchSet:
    """Return X_L as a `MatchSet`, ordered by distance ratio."""
    forward = prepared.forward
    ratio = forward.distance_ratio
    keep = np.flatnonzero((forward.nearest >= 0) & (ratio <= settings.max_distance_ratio))
    return _nearest_set(prepared, keep[np.argsort(ratio[keep], kind="stable")])


def _nearest_set(prepared: PreparedPair, rows: IntArray) -> MatchSet:
    """Return the features `rows` of image 1 with their nearest neighbours, in that order."""
    f1, f2 = prepared.features
    forward = prepared.forward
    to = forward.nearest[rows]
    n = len(rows)
    return MatchSet(
        x1=f1.xy[rows],
        x2=f2.xy[to],
        scale1=f1.scale[rows],
        scale2=f2.scale[to],
        orientation1_deg=f1.orientation_deg[rows],
        orientation2_deg=f2.orientation_deg[to],
        feature1=prepared.locations[0].of_feature[rows],
        feature2=prepared.locations[1].of_feature[to],
        probability=np.full(n, np.nan),
        supporting_matrices=np.zeros(n, np.int64),
        distance_ratio=forward.distance_ratio[rows],
        similarity_weight=similarity_weights(forward, prepared.backward)[rows],
        similarity=forward.best[rows].astype(np.float64),
        two_keypoint_probability=np.zeros(n),
    )


def standard_matches(
    image1: Image, image2: Image, *, features: FeatureSettings | None = None, max_distance_ratio: float = 0.9
) -> MatchSet:
    """Return X_L, the standard putative matches of the paper, ordered by distance ratio: the baseline.

    Parameters
    ----------
    image1, image2 : path or ndarray
        The photographs.
    features : FeatureSettings, optional
        The paper's by default: plain SIFT, normalised cross-correlation.
    max_distance_ratio : float
        Matches with a higher d_r are left out.

    References
    ----------
    Paper, section 4.1.
    """
    settings = replace(
        find_preset("paper"),
        features=features or find_preset("paper").features,
        max_distance_ratio=max_distance_ratio,
    )
    return standard_set(prepare_pair(image1, image2, settings), settings)


def snn_matches(image1: Image, image2: Image, *, max_distance_ratio: float = 0.85) -> MatchSet:
    """Return mutual nearest neighbours of RootSIFT below a ratio, ordered by it: the strongest simple baseline.

    The ratio is of Euclidean distances of the descriptors, as users of this baseline compute it.
    """
    settings = replace(DEFAULT, features=FeatureSettings(root=True, centred=False))
    prepared = prepare_pair(image1, image2, settings)
    forward = prepared.forward
    distance, distance2 = (np.sqrt(np.maximum(2 - 2 * s.astype(np.float64), 0)) for s in (forward.best, forward.second))
    ratio = np.divide(distance, distance2, out=np.ones_like(distance), where=distance2 > 0)
    keep = np.flatnonzero(mutual_mask(forward, prepared.backward) & (ratio < max_distance_ratio))
    rows = keep[np.argsort(ratio[keep], kind="stable")]
    return replace(_nearest_set(prepared, rows), distance_ratio=ratio[rows])
