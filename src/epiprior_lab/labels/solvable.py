"""Whether a rendered pair can be solved at all: how many right matches its putative matches X hold, by its depths."""

from epiprior.matching.pair import prepare_pair, roll_hypotheses
from epiprior.presets import DEFAULT
from epiprior.ranking.hypothesis import find_candidates
from epiprior_lab.labels.ground_truth import label_matches
from epiprior_lab.pairsets import Pair
from epiprior_lab.params import TruthParams


def right_among_putative(pair: Pair, labels: TruthParams) -> int:
    """Return how many matches of X (paper, section 4.3) are right, under the roll hypothesis that has most."""
    prepared = prepare_pair(pair.image1, pair.image2, DEFAULT)
    (f1, f2), (place1, place2) = prepared.features, prepared.locations
    most = 0
    for roll_deg in roll_hypotheses(prepared, DEFAULT):
        X = find_candidates(prepared, roll_deg, DEFAULT).X
        rows1, rows2 = place1.first[X.feature1], place2.first[X.feature2]
        right = label_matches(pair, f1.xy[rows1], f2.xy[rows2], f1.scale[rows1], f2.scale[rows2], settings=labels)
        most = max(most, int(right.sum()))
    return most
