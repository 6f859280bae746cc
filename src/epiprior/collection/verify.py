"""Which pairs of a collection are relied on: by their confidence, and by focal lengths that are known.

Where EXIF or the user tells both focal lengths, an essential matrix is estimated on the matches of F, and judged as F
is. It is often right where F is wrong, and then keeps fewer matches. Where most pairs lose many, these are the wrong
focal lengths.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from epiprior.collection.store import MatchedPair

if TYPE_CHECKING:
    from epiprior.collection.run import MatchedCollection

CONTRADICTS = "contradicts the focal lengths"
_LOSES = 0.75  # a pair that keeps fewer of its matches; on validation scenes one in ten right pairs keeps below 0.98


def trusts_focal_lengths(matched: "MatchedCollection", least: float, tell: Callable[[str], None] | None = None) -> bool:
    """Return whether the known focal lengths are believed; `tell` gets a line where they change anything.

    They are wrong if most of the pairs that reach the confidence `least` without them lose it, or a quarter of their
    matches, under them.
    """
    count = against = out = 0
    for plain, pair in zip(matched.plain, matched, strict=True):
        if pair.E is not None and plain.confidence >= least:
            count += 1
            out += pair.confidence < least
            now, before = (len(one.matches) - one.guided for one in (pair, plain))
            against += pair.confidence < least or now < _LOSES * before
    trusted = 2 * against <= count
    if tell and not trusted:
        tell(f"{against} of {count} pairs contradict the focal lengths of their cameras: these are wrong, and not used")
    elif tell and out:
        tell(f"{out} of {count} pairs contradict the focal lengths of their cameras: left out")
    return trusted


def judge_pairs(
    matched: "MatchedCollection", least: float, tell: Callable[[str], None] | None = None
) -> Iterator[tuple[MatchedPair, str]]:
    """Yield every pair and why it is not relied on; empty if it is.

    Pairs below the confidence `least` are not. Where focal lengths are not believed (`trusts_focal_lengths`, which
    `tell` is for), all pairs are as without. The collection is read twice.
    """
    trusted = trusts_focal_lengths(matched, least, tell)
    for plain, known in zip(matched.plain, matched, strict=True):
        pair = known if trusted else plain
        if pair.confidence < least <= plain.confidence:
            yield pair, CONTRADICTS
        elif not pair.geometry or not len(pair.matches):
            yield pair, pair.status
        else:
            yield pair, "low confidence" if pair.confidence < least else ""
