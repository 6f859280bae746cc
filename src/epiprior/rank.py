"""The composition: two images in, matches with probabilities out (paper, algorithm 1, lines 2 to 16)."""

import time

import numpy as np

from epiprior import presets
from epiprior.errors import ModelError
from epiprior.features.images import View
from epiprior.kernels.parallel import in_threads
from epiprior.matching.baselines import standard_set
from epiprior.matching.pair import PreparedPair, Stopwatch, prepare_pair, roll_hypotheses
from epiprior.presets import PreprocessSettings, find_preset
from epiprior.ranking.hypothesis import Candidates, Votes, cast_votes, cluster_images, describe_matches, find_candidates
from epiprior.ranking.models import RankingModel, load_model
from epiprior.ranking.second_round import second_round_rows, second_round_table
from epiprior.types import Features, MatchSet, RankedMatches


def rank_matches(
    image1: View | None,
    image2: View | None,
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
    image1, image2 : The photographs: a file that OpenCV reads, or uint8 of shape (H, W), (H, W, 3) RGB or (H, W, 4)
        RGBA. None where features are handed in and no image is at hand.
    preset : ``default``; ``fast``, half the features; ``thorough``, twice, of larger images; or ``paper``, as printed.
    features1, features2 : Features of the caller's own, instead of detected ones.
    settings : Instead of the preset's.
    model : Instead of the preset's own.

    Returns
    -------
    One `MatchSet` per roll hypothesis, sorted by probability, then sfm, then d_r; empty for images without texture.

    Raises
    ------
    ImageError, FeatureError, SettingsError, ModelError : For input that cannot be used; the message names it.

    References
    ----------
    Paper, algorithm 1, lines 2 to 16.
    """
    settings = settings or find_preset(preset)
    model = model or load_model(settings.model)
    _check_columns(model, settings)
    watch = Stopwatch()
    prepared = prepare_pair(
        image1, image2, settings, features1=features1, features2=features2, watch=watch, ordered=True
    )
    with watch.step("roll"):
        rolls = roll_hypotheses(prepared, settings)
    clustered = cluster_images(prepared, rolls, settings, watch)

    def rank(k: int) -> tuple[MatchSet, Stopwatch]:
        own = Stopwatch()
        candidates = find_candidates(prepared, rolls[k], settings, own, clustered=clustered[k])
        with own.step("2keypoint classifier"):
            probability = model.two_keypoint(candidates.two_keypoints.select(model.two_keypoint.columns))
        with own.step("votes"):
            votes = cast_votes(candidates.frames, candidates.two_keypoints, probability, settings)
        with own.step("probabilities"):
            return rank_voted(prepared, candidates, votes, model, settings), own

    start = time.perf_counter()
    sets, watches = zip(*in_threads(rank, range(len(rolls))), strict=True)
    watch.share(time.perf_counter() - start, watches)
    standard = standard_set(prepared, settings)
    return RankedMatches(sets=sets, standard=standard, seconds=watch.seconds, preset=settings.name)


def _check_columns(model: RankingModel, settings: PreprocessSettings) -> None:
    """Raise ModelError where the model has columns that are not computed: it is of another preset or version."""
    two_keypoint = presets.TWO_KEYPOINT_COLUMNS if settings.extended else presets.PAPER_TWO_KEYPOINT_COLUMNS
    known_columns = (two_keypoint, presets.MATCH_COLUMNS, presets.SECOND_ROUND_COLUMNS)
    again = model.second_round.columns if model.second_round else ()
    for wanted, known in zip((model.two_keypoint.columns, model.match.columns, again), known_columns, strict=True):
        missing = [name for name in wanted if name not in known]
        if missing:
            what = f"asks for columns that preset {settings.name} of this epiprior does not have"
            raise ModelError(f"model {model.name} {what}: {', '.join(missing)}")


def rank_voted(
    prepared: PreparedPair, candidates: Candidates, votes: Votes, model: RankingModel, settings: PreprocessSettings
) -> MatchSet:
    """Return X, X_L and X_B together with their probabilities, best first (section 4.6), after the votes.

    `settings.second_round` of the most probable matches are judged again, if the model can.
    """
    union, frames = candidates.united.union, candidates.united.frames
    table = describe_matches(candidates.united, prepared.table, candidates.two_keypoints, votes)
    probability = model.match(table.select(model.match.columns))
    if model.second_round and settings.second_round:
        rows = second_round_rows(probability, settings.second_round)
        again = second_round_table(rows, union, frames, table, probability, votes.matrices)
        probability[rows] = model.second_round(again.select(model.second_round.columns))
    (place1, place2), (to_working1, to_working2) = prepared.locations, prepared.to_working
    sfm, ratio = table.column("supporting_matrices"), table.column("distance_ratio")
    F = to_working2.T @ votes.matrices @ to_working1
    F /= np.maximum(np.linalg.norm(F, axis=(1, 2), keepdims=True), 1e-300)
    ranked = prepared.matches_of(
        place1.first[union.location1],
        place2.first[union.location2],
        orientation1_deg=np.rad2deg(frames.orientation1_rad),
        orientation2_deg=np.rad2deg(frames.orientation2_rad),
        probability=probability,
        supporting_matrices=sfm.astype(np.int64),
        distance_ratio=ratio,
        similarity_weight=table.column("similarity_weight"),
        similarity=frames.similarity,
        two_keypoint_probability=table.column("best_two_keypoint"),
        roll_deg=float(np.rad2deg(frames.roll_rad)),
        rough_matrices=F,
    )
    return prepared.as_given(ranked.take(np.lexsort((np.arange(len(union)), ratio, -sfm, -probability))))
