"""Which pairs of a collection are relied on: by their confidence, by known focal lengths, and by one another.

Where EXIF or the user tells both focal lengths, an essential matrix is estimated on the matches of F, and judged as F
is. It is often right where F is wrong, and then keeps fewer matches. Where most pairs lose many, these are the wrong
focal lengths. A pair that is confident and wrong, on repeated structure, is told by a third image.
"""

import functools
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from epiprior.collection.loops import contradicted_pairs
from epiprior.collection.pairs import Pair
from epiprior.collection.store import MatchedPair
from epiprior.features.images import blank_photograph
from epiprior.types import Float32Array, IntArray

if TYPE_CHECKING:
    from epiprior.collection.run import MatchedCollection

logger = logging.getLogger(__name__)
CONTRADICTS = "contradicts the focal lengths"
CONTRADICTS_OTHERS = "contradicts other pairs"
_WITH_F = ("CALIBRATED", "UNCALIBRATED")
_LOSES = 0.75  # a pair that keeps fewer of its matches; on validation scenes one in ten right pairs keeps below 0.98


@dataclass(frozen=True, kw_only=True)
class JudgedPairs:
    """The pairs of a collection, and why they are not relied on; of `judge_pairs`.

    Parameters
    ----------
    matched : The collection, with its cameras or, where their focal lengths are not believed, without.
    trusted : Whether these are believed.
    why_not : Of every pair; empty if it is relied on.
    remarks : Lines for the user, on pairs that were left out.
    """

    matched: "MatchedCollection"
    trusted: bool
    why_not: tuple[str, ...]
    remarks: tuple[str, ...]

    def __iter__(self) -> Iterator[tuple[MatchedPair, str]]:
        return zip(self.matched, self.why_not, strict=True)


def judge_pairs(matched: "MatchedCollection", least: float) -> JudgedPairs:
    """Judge every pair of a collection, which is read a few times; remarks are logged as warnings.

    Pairs below the confidence `least` are not relied on. Known focal lengths are wrong if most of the pairs that reach
    it without them lose it, or a quarter of their matches, under them; all pairs are then as without. Of pairs that
    contradict each other the least sure are left out.
    """
    count = against = out = 0
    for plain, known in zip(matched.plain, matched, strict=True):
        if known.E is not None and plain.confidence >= least:
            count += 1
            out += known.confidence < least
            now, before = (len(one.matches) - one.guided for one in (known, plain))
            against += known.confidence < least or now < _LOSES * before
    trusted, remarks = 2 * against <= count, []
    if not trusted:
        all_but = "contradict the focal lengths of their cameras: these are wrong, and not used"
        remarks.append(f"{against} of {count} pairs {all_but}")
    elif out:
        remarks.append(f"{out} of {count} pairs contradict the focal lengths of their cameras: left out")
    chosen = matched if trusted else matched.plain
    why_not = [_why_not(*both, least) for both in zip(matched.plain, chosen, strict=True)]
    contradicted = _contradicted(chosen, why_not, least)
    for row in contradicted:
        why_not[row] = CONTRADICTS_OTHERS
    if contradicted:
        remarks.append(f"{len(contradicted)} of {len(why_not)} pairs contradict others: left out")
    for remark in remarks:
        logger.warning(remark)
    return JudgedPairs(matched=chosen, trusted=trusted, why_not=tuple(why_not), remarks=tuple(remarks))


def _why_not(plain: MatchedPair, pair: MatchedPair, least: float) -> str:
    if pair.confidence < least <= plain.confidence:
        return CONTRADICTS
    if not pair.geometry or not len(pair.matches):
        return pair.status
    return "low confidence" if pair.confidence < least else ""


def _contradicted(matched: "MatchedCollection", why_not: list[str], least: float) -> list[int]:
    """Return the rows of the pairs that are relied on, and contradict others by the matches that F comes from.

    Watermarks do not count. Homographies have no probability: the least that is relied on.
    """
    limit = matched.how.settings.features.max_image_size
    rows = {pair: row for row, pair in enumerate(matched.pairs) if not why_not[row]}
    confidence = {}
    for pair in list(rows):
        found = matched.read(pair)
        if found.geometry == "WATERMARK":
            del rows[pair]
        else:
            confidence[pair] = found.confidence if found.geometry in _WITH_F else least

    def matches(pair: Pair) -> IntArray:
        found = matched.read(pair)
        return found.matches[: len(found.matches) - found.guided]

    @functools.lru_cache(maxsize=512)
    def xy(place: int) -> Float32Array:
        own = matched.features(place)
        return (own.xy / blank_photograph(own.image_size, limit).factor).astype(np.float32)

    return sorted(rows[pair] for pair in contradicted_pairs(confidence, matches, xy))
