"""Why a match has its probability: what the classifiers saw of it, what holds it, and the F that it supports.

`rank_matches` keeps none of this, so its steps run again up to the roll hypothesis of the match.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from epiprior.errors import SettingsError
from epiprior.features.images import View
from epiprior.geometry import sampson_distance
from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.matching.pair import PreparedPair, prepare_pair, roll_hypotheses
from epiprior.presets import PreprocessSettings, find_preset
from epiprior.rank import rank_voted
from epiprior.ranking.hypothesis import Candidates, Votes, cast_votes, describe_matches, find_candidates
from epiprior.ranking.models import Classifier, RankingModel, load_model
from epiprior.ranking.probabilities import MatchTable
from epiprior.ranking.second_round import second_round_rows, second_round_table
from epiprior.ranking.two_keypoints import best_two_keypoint_matches
from epiprior.types import BoolArray, Features, FloatArray, IntArray, MatchSet

MOST_PROBABLE = 100  # so many matches stand for the most probable ones; the less probable half for the least
HEADER = ("column", "value", "most", "least", "p if most", "p if least")


@dataclass(frozen=True)
class ExplainedColumn:
    """One column of a match, beside the same of other matches that its classifier judged.

    Nobody knows which of these are right: the comparison is with those that the ranking puts first and last.
    """

    name: str
    value: float  # of the match
    most_probable: float  # median over the `MOST_PROBABLE` most probable matches
    least_probable: float  # and over the less probable half
    as_most: float  # the probability that the classifier would give if this column alone had the first median
    as_least: float  # and the second

    def cells(self) -> tuple[str, ...]:
        """Return the column as words below `HEADER`."""
        numbers = (self.value, self.most_probable, self.least_probable, self.as_most, self.as_least)
        return self.name, *(f"{v:.0f}" if abs(v) >= 1000 else f"{v:.3g}" for v in numbers)


@dataclass(frozen=True, kw_only=True)
class ExplainedRound:
    """What one classifier said of the match, how many matches it judged, and what it saw (section 4.6)."""

    probability: float
    judged: int
    columns: tuple[ExplainedColumn, ...]

    def decisive(self, count: int = 12) -> tuple[ExplainedColumn, ...]:
        """Return the columns by which the probability would change most, first those of the largest change."""
        change = [max(abs(c.as_most - self.probability), abs(c.as_least - self.probability)) for c in self.columns]
        return tuple(self.columns[k] for k in np.argsort(np.negative(change), kind="stable")[:count])


@dataclass(frozen=True, kw_only=True)
class SupportedMatrix:
    """The rough F that the match supports and that the other matches support best (section 4.5)."""

    index: int  # in `rough_matrices` of the ranking
    F: FloatArray  # (3, 3), pixels of the images as given
    made_of: IntArray  # (2, 2), the two matches of 2keypoints that it was made of: two rows of the ranking each
    residual_px: float  # Sampson distance of the match, at working size
    inliers: int  # other matches that support it, one-to-one and without those that share a feature with the match
    probability_sum: float  # of their probabilities: by this it is the best


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """What `explain_match` returns.

    Parameters
    ----------
    match : The number that was asked for.
    set : Number of its roll hypothesis.
    row : Of the match in `ranked`.
    ranked : All matches of that roll hypothesis, as `rank_matches` returns them.
    turned : The images were compared in the other order: image 1 of the columns' names is image 2 as given.
    rounds : One, or two where the match was judged again; the last one's probability counts.
    in_x : Whether it is a putative match; outside X are standard matches, which have no votes.
    partners : (K,) int64. Rows of the matches with which it forms a match of 2keypoints (section 4.4), most probable
        first.
    partner_probability : (K,) float64. Probability of that match of 2keypoints.
    partner_voted : (K,) bool. Whether it is one of those that rough F are made of.
    self_made : So many of the rough F that the match supports were made of the match itself.
    best : None where it supports no rough F.
    """

    match: int
    set: int
    row: int
    ranked: MatchSet
    turned: bool
    rounds: tuple[ExplainedRound, ...]
    in_x: bool
    partners: IntArray
    partner_probability: FloatArray
    partner_voted: BoolArray
    self_made: int
    best: SupportedMatrix | None

    @property
    def probability(self) -> float:
        """Probability that the match is right, in [0, 1]."""
        return float(self.ranked.probability[self.row])

    def sentences(self) -> tuple[str, str, str, str]:
        """Say what holds the match, how many rough F it supports, what the best is, and what the columns are."""
        held, supported, best = "a standard match outside X: nothing holds it, and it has no votes", "", ""
        if self.in_x:
            held = f"matches of 2keypoints that hold it: {len(self.partners)}"
            count, own = self.ranked.supporting_matrices[self.row], self.self_made
            supported = f"it supports {count} of {len(self.ranked.rough_matrices)} rough F, {own} made of itself"
        if len(self.partners):
            voted = np.count_nonzero(self.partner_voted)
            held += f", the best with probability {self.partner_probability[0]:.3g}; {voted} of them made rough F"
        if b := self.best:
            best = f"best rough F near it: number {b.index}, at {b.residual_px:.2f} px; {b.inliers} other matches "
            best += f"support it, their probabilities sum to {b.probability_sum:.1f}"
        number, most = len(self.rounds), min(MOST_PROBABLE, self.rounds[-1].judged)
        columns = (
            f"round {number}; most, least: medians of the {most} most probable matches and of the less probable half"
        )
        columns += "; side 1 is the second image" if self.turned else ""
        return held, supported, best or "no rough F is near it", columns


def explain_match(
    image1: View | None,
    image2: View | None,
    match: int,
    *,
    preset: str = "default",
    features1: Features | None = None,
    features2: Features | None = None,
    settings: PreprocessSettings | None = None,
) -> Explanation:
    """Explain the probability of one match of two photographs.

    Parameters
    ----------
    match : Its number, from 0: its row in the sets of `rank_matches`, one below the other, as they are written.
    image1, image2, preset, features1, features2, settings : Those that the matches were ranked with, see
        `rank_matches`.

    Raises
    ------
    ImageError, FeatureError, SettingsError, ModelError : For input that cannot be used; the message names it, and
        where `match` is out of range how many matches there are.
    """
    if match < 0:
        raise SettingsError(f"match is {match}, must be at least 0")
    settings = settings or find_preset(preset)
    model = load_model(settings.model)
    prepared = prepare_pair(image1, image2, settings, features1=features1, features2=features2, ordered=True)
    before = 0
    for number, roll_deg in enumerate(roll_hypotheses(prepared, settings)):
        ranking = _run(prepared, roll_deg, model, settings)
        if match < before + len(ranking.ranked):
            return _explain(match, number, match - before, ranking)
        before += len(ranking.ranked)
    raise SettingsError(f"match is {match}, but there are {before} matches, counted from 0")


@dataclass(frozen=True)
class _Ranking:
    """The steps of one roll hypothesis; rows of the union and of the ranking, in terms of each other."""

    prepared: PreparedPair
    candidates: Candidates
    votes: Votes
    ranked: MatchSet
    model: RankingModel
    settings: PreprocessSettings

    @cached_property
    def order(self) -> IntArray:
        """Row in the union of each ranked match."""
        own, (place1, place2) = self.prepared.as_given(self.ranked), self.prepared.locations  # swapped twice
        union, width = self.candidates.united.union, len(self.prepared.features[1])
        key = place1.first[union.location1] * width + place2.first[union.location2]
        sorter = np.argsort(key)
        return np.asarray(sorter[np.searchsorted(key, own.feature1 * width + own.feature2, sorter=sorter)])

    @cached_property
    def place(self) -> IntArray:
        """Row in the ranking of each match of the union."""
        return np.argsort(self.order)


def _run(prepared: PreparedPair, roll_deg: float, model: RankingModel, settings: PreprocessSettings) -> _Ranking:
    candidates = find_candidates(prepared, roll_deg, settings)
    pairs = candidates.two_keypoints
    probability = model.two_keypoint(pairs.select(model.two_keypoint.columns))
    votes = cast_votes(candidates.frames, pairs, probability, settings)
    ranked = rank_voted(prepared, candidates, votes, model, settings)
    return _Ranking(prepared, candidates, votes, ranked, model, settings)


def _explain(match: int, number: int, row: int, ranking: _Ranking) -> Explanation:
    pairs, probability = ranking.candidates.two_keypoints, ranking.votes.probability
    row_of_x = ranking.place[ranking.candidates.united.union.in_x >= 0]  # the union keeps the order of X
    ends = np.column_stack([row_of_x[pairs.main], row_of_x[pairs.other]])
    holds = (ends == row).any(axis=1)
    partner = ends.sum(axis=1) - row
    held = np.flatnonzero(holds)
    held = held[np.argsort(-probability[held], kind="stable")]
    # A match of 2keypoints and its swap have one partner; the more probable one counts.
    held = held[np.sort(np.unique(partner[held], return_index=True)[1])]
    chosen = best_two_keypoint_matches(pairs, probability, ranking.settings.two_keypoint_count)
    best, self_made = _best_supported(row, ranking, ends[chosen])
    return Explanation(
        match=match,
        set=number,
        row=row,
        ranked=ranking.ranked,
        turned=ranking.prepared.turned,
        rounds=_explain_rounds(row, ranking),
        in_x=row in row_of_x,
        partners=partner[held],
        partner_probability=probability[held],
        partner_voted=np.isin(partner[held], partner[chosen[holds[chosen]]]),
        self_made=self_made,
        best=best,
    )


def _best_supported(row: int, ranking: _Ranking, ends: IntArray) -> tuple[SupportedMatrix | None, int]:
    """Return the best rough F that a match supports, and how many of those that it supports were made of it.

    `ends`, (K, 2), are the rows of the matches of 2keypoints that each two made a rough F.
    """
    matrices, ranked, limit = ranking.votes.matrices, ranking.ranked, ranking.settings.vote_threshold
    frames = ranking.candidates.united.frames.take(ranking.order)
    own = frames.take(np.array([row]))
    distance = np.array([float(sampson_distance(F, own.x1, own.x2)[0]) for F in matrices])
    supported = np.flatnonzero(distance < limit)
    made_of = np.stack([ends[k] for k in np.triu_indices(len(ends), 1)], axis=1)[supported]
    others = one_to_one_mask(ranked.feature1, ranked.feature2)
    others &= (ranked.feature1 != ranked.feature1[row]) & (ranked.feature2 != ranked.feature2[row])
    x1, x2, probability = frames.x1[others], frames.x2[others], ranked.probability[others]
    near = [sampson_distance(matrices[k], x1, x2) < limit for k in supported]
    self_made = int((made_of == row).any(axis=(1, 2)).sum())
    if not near:
        return None, self_made
    sums = [float(probability[inside].sum()) for inside in near]
    top = int(np.argmax(sums))
    index = int(supported[top])
    best = SupportedMatrix(
        index=index,
        F=ranked.rough_matrices[index],
        made_of=made_of[top],
        residual_px=float(distance[index]),
        inliers=int(near[top].sum()),
        probability_sum=sums[top],
    )
    return best, self_made


def _explain_rounds(row: int, ranking: _Ranking) -> tuple[ExplainedRound, ...]:
    united, model, count = ranking.candidates.united, ranking.model, ranking.settings.second_round
    own = int(ranking.order[row])
    table = describe_matches(united, ranking.prepared.table, ranking.candidates.two_keypoints, ranking.votes)
    first = _explain_round(model.match, table, own, ranking.order)
    probability = model.match(table.select(model.match.columns))
    judged = second_round_rows(probability, count)
    if model.second_round is None or own not in judged:
        return (first,)
    again = second_round_table(judged, united.union, united.frames, table, probability, ranking.votes.matrices)
    place = int(np.flatnonzero(judged == own)[0])
    return first, _explain_round(model.second_round, again, place, np.argsort(ranking.place[judged]))


def _explain_round(classifier: Classifier, table: MatchTable, own: int, order: IntArray) -> ExplainedRound:
    """Explain row `own` of those that a classifier judged; `order` is of its rows, the most probable first."""
    rows = table.select(classifier.columns)[order]
    value = table.select(classifier.columns)[own]
    most, least = np.median(rows[:MOST_PROBABLE], axis=0), np.median(rows[len(rows) // 2 :], axis=0)
    each = np.arange(len(value))
    asked = np.tile(value, (2, len(value), 1))
    asked[0, each, each], asked[1, each, each] = most, least
    said = classifier(np.concatenate([value[None], *asked]))
    numbers = zip(value.tolist(), most.tolist(), least.tolist(), *said[1:].reshape(2, -1).tolist(), strict=True)
    columns = [ExplainedColumn(name, *five) for name, five in zip(classifier.columns, numbers, strict=True)]
    return ExplainedRound(probability=float(said[0]), judged=len(rows), columns=tuple(columns))
