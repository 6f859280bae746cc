"""The composition: two images in, matches with probabilities out (paper, algorithm 1 but for its last steps).

`rank_matches` does everything. The functions below it are its steps, for those who want to look inside or to train:
`prepare_pair` (sections 4.1), `roll_hypotheses` (4.2), `find_candidates` (4.2 to 4.4), `cast_votes` (4.5) and
`describe_matches` (4.6).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from collections.abc import Iterator

import numpy as np

from epiprior import roll
from epiprior.clusters import Clusters, cluster_features
from epiprior.compilation import announce_compilation
from epiprior.errors import FeatureError, ImageError
from epiprior.features import (
    FeatureSettings,
    Image,
    Photograph,
    describe_at_orientation,
    detect_features,
    load_photograph,
    normalise_descriptors,
)
from epiprior.frames import Locations, MatchFrames, locate, match_frames
from epiprior.models import RankingModel, load_model
from epiprior.presets import DEFAULT, PreprocessSettings, find_preset
from epiprior.probabilities import (
    MatchTable,
    StandardTable,
    Union,
    match_table,
    standard_table,
    two_keypoint_scores,
    unite,
)
from epiprior.putative import PutativeMatches, putative_matches
from epiprior.standard import Neighbours, mutual_mask, nearest_neighbours, similarity_weights
from epiprior.two_keypoints import (
    TwoKeypointMatches,
    best_two_keypoint_matches,
    describe_two_keypoint_matches,
    match_two_keypoints,
    neighbourhoods,
)
from epiprior.types import Features, Float32Array, FloatArray, IntArray, MatchSet, RankedMatches
from epiprior.votes import count_votes, frame_points, rough_fundamental_matrices


class Stopwatch:
    """Wall time per named step; a step that is repeated adds up."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time the body of a with statement."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@dataclass(frozen=True, kw_only=True)
class PreparedPair:
    """Features of both images and their nearest neighbours: all that does not depend on the roll.

    Parameters
    ----------
    photographs : tuple of (Photograph or None)
        The working images; None for an image that was not handed in.
    features : tuple of Features
        As detected or handed in.
    descriptors : tuple of ndarray
        Unit descriptors at the features' own orientation.
    to_working : tuple of ndarray, shape (3, 3)
        Affine maps from pixels of the images as given to working pixels.
    locations : tuple of Locations
        Features grouped by location and scale, working pixels.
    forward, backward : Neighbours
        Of the features, in both directions.
    table : StandardTable
        X_L and X_B by location.
    """

    photographs: tuple[Photograph | None, Photograph | None]
    features: tuple[Features, Features]
    descriptors: tuple[Float32Array, Float32Array]
    to_working: tuple[FloatArray, FloatArray]
    locations: tuple[Locations, Locations]
    forward: Neighbours
    backward: Neighbours
    table: StandardTable

    @property
    def orientation_rad(self) -> tuple[FloatArray, FloatArray]:
        """Orientation of the features of both images, radians."""
        return np.deg2rad(self.features[0].orientation_deg), np.deg2rad(self.features[1].orientation_deg)


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """What one roll hypothesis proposes.

    Parameters
    ----------
    roll_deg : float
        The hypothesis.
    fixed : tuple of ndarray
        Unit descriptors of the locations of both images at its orientations.
    X : PutativeMatches
        Putative matches of locations.
    frames : MatchFrames
        Of the rows of X.
    two_keypoints : TwoKeypointMatches
        With their descriptors 2kpmd.
    """

    roll_deg: float
    fixed: tuple[Float32Array, Float32Array]
    X: PutativeMatches
    frames: MatchFrames
    two_keypoints: TwoKeypointMatches


@dataclass(frozen=True, kw_only=True)
class Votes:
    """The rough fundamental matrices of one roll hypothesis and what they say of each row of X.

    Parameters
    ----------
    matrices : ndarray, shape (P, 3, 3), float64
        Working pixels.
    chosen : ndarray, shape (K,), int64
        The 2keypoint matches they come from, best first.
    sfm : ndarray, shape (len(X),), int64
        Number of supported matrices.
    weighted : ndarray, shape (len(X),), float64
        The same, each matrix weighted by the product of the probabilities of its two 2keypoint matches.
    probability : ndarray, shape (T,), float64
        Of all 2keypoint matches.
    """

    matrices: FloatArray
    chosen: IntArray
    sfm: IntArray
    weighted: FloatArray
    probability: FloatArray = field(repr=False)


def _both(function: Callable[[int], object]) -> tuple[object, object]:
    """Call `function` for both images, side by side."""
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(function, (0, 1))
    return first, second


def prepare_pair(
    image1: Image | None,
    image2: Image | None,
    settings: PreprocessSettings = DEFAULT,
    *,
    features1: Features | None = None,
    features2: Features | None = None,
    watch: Stopwatch | None = None,
) -> PreparedPair:
    """Find features and standard matches (section 4.1).

    Parameters
    ----------
    image1, image2 : path, ndarray or None
        The photographs. None only where features are handed in; then their own descriptors also serve where the
        method asks for descriptors at a fixed orientation, and repeated corners are told apart less well.
    settings : PreprocessSettings
        The preset.
    features1, features2 : Features, optional
        Used instead of detected ones; pixels of the images as given.
    watch : Stopwatch, optional
        Takes the seconds of the steps.
    """
    watch = watch or Stopwatch()
    images, given = (image1, image2), (features1, features2)
    for k, (image, own) in enumerate(zip(images, given, strict=True), start=1):
        if image is None and own is None:
            raise ImageError(f"image {k} is None and no features were handed in for it")

    def find(k: int) -> tuple[Photograph | None, Features]:
        image, own = images[k], given[k]
        photograph = None if image is None else load_photograph(image, settings.features.max_image_size)
        if own is None:
            assert photograph is not None
            own = detect_features(photograph, settings.features)
        elif photograph is not None and own.image_size != photograph.size:
            raise FeatureError(
                f"features of image {k + 1} belong to an image of {own.image_size}, the image is {photograph.size}"
            )
        return photograph, own

    with watch.step("features"):
        (photo1, own1), (photo2, own2) = _both(find)  # type: ignore[misc]
    if own1.descriptors.shape[1] != own2.descriptors.shape[1]:
        raise FeatureError(
            f"descriptors have {own1.descriptors.shape[1]} and {own2.descriptors.shape[1]} entries, expected the same"
        )
    with watch.step("standard matches"):
        descriptors = (_unit(own1.descriptors, settings.features), _unit(own2.descriptors, settings.features))
        forward, backward = nearest_neighbours(*descriptors)
        working = (_working(own1, photo1, settings), _working(own2, photo2, settings))
        locations = tuple(
            locate(own, work.to_working(own.xy), work.factor) for own, work in zip((own1, own2), working, strict=True)
        )
        of = (locations[0].of_feature, locations[1].of_feature)
        table = standard_table(forward, backward, of, settings.max_distance_ratio)
    return PreparedPair(
        photographs=(photo1, photo2),
        features=(own1, own2),
        descriptors=descriptors,
        to_working=(working[0].working_map, working[1].working_map),
        locations=locations,
        forward=forward,
        backward=backward,
        table=table,
    )


def _unit(descriptors: Float32Array, settings: FeatureSettings) -> Float32Array:
    return normalise_descriptors(descriptors, root=settings.root, centred=settings.centred)


def _working(features: Features, photograph: Photograph | None, settings: PreprocessSettings) -> Photograph:
    """Return the photograph, or a blank one of the right sizes, for its change of coordinates."""
    if photograph is not None:
        return photograph
    width, height = features.image_size
    ratio = min(1.0, settings.features.max_image_size / max(width, height))
    blank = np.empty((max(1, round(height * ratio)), max(1, round(width * ratio))), np.uint8)
    return Photograph(blank, features.image_size)


def roll_hypotheses(prepared: PreparedPair, settings: PreprocessSettings = DEFAULT) -> tuple[float, ...]:
    """Return the roll hypotheses alpha_exp and 0, degrees (section 4.2); one where they nearly agree."""
    expected = roll.expected_roll(roll_differences(prepared, settings), settings.roll_bandwidth_deg)
    return (0.0,) if abs(expected) <= settings.merge_rolls_deg and settings.merge_rolls_deg > 0 else (expected, 0.0)


def roll_differences(prepared: PreparedPair, settings: PreprocessSettings = DEFAULT) -> FloatArray:
    """Return the orientation differences over X_L and X_B, degrees in [0, 360)."""
    forward = prepared.forward
    mask = mutual_mask(forward, prepared.backward) | (forward.distance_ratio <= settings.max_distance_ratio)
    rows = np.flatnonzero(mask & (forward.nearest >= 0))
    first, second = prepared.features
    return roll.orientation_differences(
        first.orientation_deg[rows], second.orientation_deg[forward.nearest[rows]]
    )


def find_candidates(
    prepared: PreparedPair, roll_deg: float, settings: PreprocessSettings = DEFAULT, watch: Stopwatch | None = None
) -> Candidates:
    """Cluster the features, match clusters, match 2keypoints (sections 4.2 to 4.4), under one roll hypothesis."""
    watch = watch or Stopwatch()

    def describe(k: int) -> Float32Array:
        features, photograph, first = prepared.features[k], prepared.photographs[k], prepared.locations[k].first
        if photograph is None:
            return prepared.descriptors[k][first]
        raw = describe_at_orientation(photograph, features.take(first), roll_deg if k else 0.0)
        return _unit(raw, settings.features)

    def cluster(k: int) -> Clusters:
        return cluster_features(fixed[k], settings.min_cluster_similarity)

    with watch.step("fixed orientation"):
        fixed: tuple[Float32Array, Float32Array] = _both(describe)  # type: ignore[assignment]
    with watch.step("clusters"):
        clusters1, clusters2 = _both(cluster)
        assert isinstance(clusters1, Clusters) and isinstance(clusters2, Clusters)  # noqa: PT018
    with watch.step("putative matches"):
        X = putative_matches(clusters1, clusters2, *fixed, settings.max_matches_per_cluster_pair)
        frames = _frames(prepared, X.feature1, X.feature2, fixed, roll_deg)
    with watch.step("2keypoints"):
        two_keypoints = _two_keypoints(prepared, X, frames, (clusters1.label, clusters2.label), settings)
    return Candidates(roll_deg=roll_deg, fixed=fixed, X=X, frames=frames, two_keypoints=two_keypoints)


def _frames(
    prepared: PreparedPair,
    rows1: IntArray,
    rows2: IntArray,
    fixed: tuple[Float32Array, Float32Array],
    roll_deg: float,
) -> MatchFrames:
    return match_frames(
        rows1,
        rows2,
        prepared.locations,
        prepared.orientation_rad,
        prepared.descriptors,
        fixed,
        float(np.deg2rad(roll_deg)),
    )


def _two_keypoints(
    prepared: PreparedPair,
    X: PutativeMatches,
    frames: MatchFrames,
    labels: tuple[IntArray, IntArray],
    settings: PreprocessSettings,
) -> TwoKeypointMatches:
    around = [
        neighbourhoods(
            place.xy,
            place.scale,
            label,
            nearest=settings.nearest,
            within=settings.within,
            nearest_of_cluster=settings.nearest_of_cluster,
            max_within=settings.max_within,
        )
        for place, label in zip(prepared.locations, labels, strict=True)
    ]
    main, other = match_two_keypoints(X, *around)
    same = labels[0][X.feature1[main]] == labels[0][X.feature1[other]]
    same &= labels[1][X.feature2[main]] == labels[1][X.feature2[other]]
    return describe_two_keypoint_matches(X, frames, main, other, same, extended=settings.extended)


def cast_votes(
    frames: MatchFrames,
    pairs: TwoKeypointMatches,
    probability: FloatArray,
    settings: PreprocessSettings = DEFAULT,
) -> Votes:
    """Choose the best 2keypoint matches, make a rough F of every two, count their votes (sections 4.4 and 4.5).

    Parameters
    ----------
    frames : MatchFrames
        Of the rows of X.
    pairs : TwoKeypointMatches
        T matches of 2keypoints.
    probability : ndarray, shape (T,), float64
        That each 2keypoint match is right.
    settings : PreprocessSettings
        The preset.
    """
    chosen = best_two_keypoint_matches(pairs, probability, settings.two_keypoint_count)
    y1, y2 = frame_points(
        frames, pairs.main[chosen], pairs.other[chosen], frame=settings.frame, radius=settings.frame_radius
    )
    F = rough_fundamental_matrices(y1, y2)
    i, j = np.triu_indices(len(chosen), 1)
    weights = probability[chosen][i] * probability[chosen][j]
    sfm, weighted = count_votes(F, frames.x1, frames.x2, settings.vote_threshold, weights)
    return Votes(matrices=F, chosen=chosen, sfm=sfm, weighted=weighted, probability=probability)


@dataclass(frozen=True, kw_only=True)
class UnitedMatches:
    """X, X_L and X_B of one roll hypothesis together, with all of kpmd that does not depend on a classifier.

    Parameters
    ----------
    union : Union
        M matches of locations.
    frames : MatchFrames
        Of each match.
    roll_error : ndarray, shape (M,), float64
        Deviation of the match's turn from the roll hypothesis, radians in [0, pi].
    scale_change : ndarray, shape (M,), float64
        Size of the log of the scale change.
    """

    union: Union
    frames: MatchFrames
    roll_error: FloatArray
    scale_change: FloatArray


def unite_matches(prepared: PreparedPair, candidates: Candidates) -> UnitedMatches:
    """Unite X, X_L and X_B (section 4.6)."""
    union = unite(candidates.X, prepared.table)
    frames = _frames(prepared, union.location1, union.location2, candidates.fixed, candidates.roll_deg)
    turn = frames.orientation2_rad - frames.orientation1_rad - frames.roll_rad
    return UnitedMatches(
        union=union,
        frames=frames,
        roll_error=np.abs(np.angle(np.exp(1j * turn))),
        scale_change=np.abs(np.log(frames.scale2 / frames.scale1)),
    )


def describe_matches(
    united: UnitedMatches, table: StandardTable, two_keypoints: TwoKeypointMatches, votes: Votes
) -> MatchTable:
    """Describe every match by kpmd (section 4.6)."""
    frames = united.frames
    appearance = (frames.similarity, frames.fixed_similarity, united.roll_error, united.scale_change)
    scores = two_keypoint_scores(two_keypoints, votes.probability, len(votes.sfm))
    return match_table(united.union, table, votes.sfm, votes.weighted, scores, appearance)


def rank_matches(
    image1: Image | None,
    image2: Image | None,
    *,
    preset: str = "default",
    features1: Features | None = None,
    features2: Features | None = None,
    settings: PreprocessSettings | None = None,
    model: RankingModel | None = None,
) -> RankedMatches:
    """Return the putative matches of two photographs with the probability that each is right.

    Parameters
    ----------
    image1, image2 : path or ndarray
        The photographs: a file that OpenCV reads, or uint8 of shape (H, W) or (H, W, 3) RGB. None where features are
        handed in and no image is at hand.
    preset : str
        ``default``, the best that we measured, or ``paper``, the paper as printed.
    features1, features2 : Features, optional
        Features of the caller's own, instead of detected ones.
    settings : PreprocessSettings, optional
        Instead of the preset's.
    model : RankingModel, optional
        Instead of the preset's own.

    Returns
    -------
    RankedMatches
        One `MatchSet` per roll hypothesis, each sorted best first: by probability, then sfm, then d_r. Empty sets for
        images without texture.

    Raises
    ------
    ImageError, FeatureError, SettingsError, ModelError
        For input that cannot be used; the message names it.

    References
    ----------
    Paper, algorithm 1, lines 2 to 16.
    """
    settings = settings or find_preset(preset)
    announce_compilation()
    model = model or load_model(settings.name)
    watch = Stopwatch()
    prepared = prepare_pair(
        image1, image2, settings, features1=features1, features2=features2, watch=watch
    )
    with watch.step("roll"):
        rolls = roll_hypotheses(prepared, settings)
    sets = tuple(_rank_one(prepared, roll_deg, settings, model, watch) for roll_deg in rolls)
    return RankedMatches(
        sets=sets, standard=standard_set(prepared, settings), seconds=watch.seconds, preset=settings.name
    )


def _rank_one(
    prepared: PreparedPair, roll_deg: float, settings: PreprocessSettings, model: RankingModel, watch: Stopwatch
) -> MatchSet:
    candidates = find_candidates(prepared, roll_deg, settings, watch)
    with watch.step("2keypoint classifier"):
        rows = candidates.two_keypoints.select(model.two_keypoint_columns)
        probability = model.predict_two_keypoint(rows)
    with watch.step("votes"):
        votes = cast_votes(candidates.frames, candidates.two_keypoints, probability, settings)
    with watch.step("probabilities"):
        united = unite_matches(prepared, candidates)
        table = describe_matches(united, prepared.table, candidates.two_keypoints, votes)
        match_probability = model.predict_match(table.select(model.match_columns))
        return _match_set(prepared, united, table, votes, match_probability)


def _match_set(
    prepared: PreparedPair, united: UnitedMatches, table: MatchTable, votes: Votes, probability: FloatArray
) -> MatchSet:
    """Bring everything back to pixels of the given images, sorted best first."""
    union, frames = united.union, united.frames
    sfm, ratio = table.column("supporting_matrices"), table.column("distance_ratio")
    order = np.lexsort((np.arange(len(union)), ratio, -sfm, -probability))
    first1, first2 = (place.first for place in prepared.locations)
    f1, f2 = prepared.features
    row1, row2 = first1[union.location1], first2[union.location2]
    ranked = MatchSet(
        x1=f1.xy[row1],
        x2=f2.xy[row2],
        scale1=f1.scale[row1],
        scale2=f2.scale[row2],
        orientation1_deg=np.rad2deg(frames.orientation1_rad),
        orientation2_deg=np.rad2deg(frames.orientation2_rad),
        feature1=union.location1,
        feature2=union.location2,
        probability=probability,
        supporting_matrices=sfm.astype(np.int64),
        distance_ratio=ratio,
        similarity_weight=table.column("similarity_weight"),
        similarity=frames.similarity,
        two_keypoint_probability=table.column("best_two_keypoint"),
        roll_deg=float(np.rad2deg(frames.roll_rad)),
        rough_matrices=_to_given(prepared, votes.matrices),
    )
    return ranked.take(order)


def _to_given(prepared: PreparedPair, F: FloatArray) -> FloatArray:
    """Express fundamental matrices of working pixels in pixels of the given images, Frobenius norm 1."""
    first, second = prepared.to_working
    given = second.T @ F @ first
    return given / np.maximum(np.linalg.norm(given, axis=(1, 2), keepdims=True), 1e-300)


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
