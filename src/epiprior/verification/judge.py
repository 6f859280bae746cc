"""epiprior's own verdict on F: whether its support means anything, and whether anything decides it."""

from epiprior.geometry import MIN_MATCHES, sampson_distance
from epiprior.types import FloatArray, Status
from epiprior.verification.chance import MATCHES_PER_F, beyond_chance, chance_rate, distinct_count
from epiprior.verification.degeneracy import LEVELS, DecidedLevels, why_degenerate
from epiprior.verification.overlay import why_overlay


def judge(
    F: FloatArray, x1: FloatArray, x2: FloatArray, threshold_px: float, levels: DecidedLevels = LEVELS
) -> tuple[Status, str]:
    """Return the status that a normalised F deserves on the matches (N, 2) it was estimated from, and why.

    ``no_model`` below 8 distinct inliers or where chance would give as many (`epiprior.verification.chance`);
    ``degenerate`` where they lie on an overlay (`epiprior.verification.overlay`) or leave F undecided
    (`epiprior.verification.degeneracy`, with its `levels`); else ``ok``.
    """
    inliers = sampson_distance(F, x1, x2) < threshold_px
    distinct = distinct_count(x1[inliers], x2[inliers])
    if distinct < MIN_MATCHES:
        return Status.NO_MODEL, f"only {distinct} distinct inliers, at least {MIN_MATCHES} are needed"
    rate = chance_rate(F, x1, x2, threshold_px)
    if not beyond_chance(distinct, distinct_count(x1, x2), rate, MATCHES_PER_F):
        return Status.NO_MODEL, f"{distinct} distinct inliers of {len(x1)} matches are no more than chance gives"
    why = why_overlay(F, x1, x2, threshold_px=threshold_px, rate=rate)
    why = why or why_degenerate(F, x1, x2, threshold_px=threshold_px, rate=rate, levels=levels)
    return (Status.DEGENERATE, why) if why else (Status.OK, "")
