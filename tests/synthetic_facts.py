"""Facts of F on matches that are handed over and collected as they are."""

from epiprior.geometry import sampson_distance
from epiprior.types import FloatArray, MatchSet
from epiprior.verification.degeneracy import fit_homography
from epiprior.verification.facts import Facts, describe_estimate
from epiprior.verification.measures import SpreadEvidence


def facts_of(F: FloatArray, matches: MatchSet, others: tuple[FloatArray, ...] = ()) -> Facts:
    """Return the facts of an estimate at 1.5 px."""
    near = sampson_distance(F, matches.x1, matches.x2) < 1.5
    H = fit_homography(matches.x1[near], matches.x2[near], 4.0)
    return describe_estimate(F, H, SpreadEvidence(matches), matches, matches, 1.5, others)
