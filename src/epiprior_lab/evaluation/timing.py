"""Wall time of the whole pipeline, from image files to F, by estimator and input, and of the cascade of two inputs.

One process, one pair at a time (after the paper's figure of time overhead); no result depends on these times.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from epiprior.features.images import load_photograph
from epiprior.types import FundamentalEstimate
from epiprior.verification.cascade import CascadeRule
from epiprior_lab.evaluation import inputs
from epiprior_lab.evaluation.learned import SCRIPT, time_learned
from epiprior_lab.evaluation.protocol import Protocol, as_shipped
from epiprior_lab.evaluation.records import CASCADE, TimingRecord
from epiprior_lab.evaluation.runs import estimates
from epiprior_lab.evaluation.truth import pair_truth
from epiprior_lab.features.detection import detect_pair
from epiprior_lab.labels.ground_truth import error_px
from epiprior_lab.pairsets import Pair

Seconds = Mapping[str, float]


def spread_pairs(pairs: Sequence[Pair], count: int) -> list[Pair]:
    """Return so many of the pairs, taken evenly."""
    return list(pairs[:: max(1, len(pairs) // count)][:count])


def time_pair(
    pair: Pair, protocol: Protocol, rule: CascadeRule, *, group: str, seeds: Sequence[int]
) -> list[TimingRecord]:
    """Time one pair by input, estimator and seed; records of the cascade come last.

    Images are read anew for each input, since that is what a user pays. Inputs of peers are left out.
    """
    found: dict[tuple[str, int, str], tuple[TimingRecord, FundamentalEstimate]] = {}
    for name in (name for name in protocol.all_inputs if name in inputs.INPUTS):
        start = time.perf_counter()
        detected = detect_pair(pair, inputs.detection_of(name))
        middle = time.perf_counter()
        matches = inputs.match_detected(detected, (name,))
        before = {"seconds_features": middle - start, "seconds_matching": time.perf_counter() - middle}
        for record, estimate in _time_estimators(pair, protocol, matches, group=group, seeds=seeds, before=before):
            found[record.estimator, record.seed, name] = record, estimate
    records = [record for record, _ in found.values()]
    shipped = as_shipped(protocol, inputs.FIRST)
    for (estimator, seed, name), first in found.items():
        second = found.get((estimator, seed, inputs.PREPROCESSED))
        if name == inputs.FIRST and estimator in shipped and second is not None:
            records.append(_cascade(first, second, rule))
    return records


def time_learned_pairs(
    pairs: Sequence[tuple[str, Pair]],
    peer: str,
    protocol: Protocol,
    *,
    seeds: Sequence[int],
    python: Path,
    threads: int,
) -> list[TimingRecord]:
    """Time a learned matcher on pairs, each with its group, and the estimators on what it finds.

    It runs in the interpreter `python` with so many `threads`, one process for all pairs; seconds are measured in it.
    """
    images = [(pair.image1, pair.image2) for _, pair in pairs]
    matched, seconds = time_learned(images=images, peer=peer, python=python, script=SCRIPT, threads=threads)
    records = []
    for (group, pair), columns, (features, matching) in zip(pairs, matched, seconds, strict=True):
        photographs = [load_photograph(path) for path in (pair.image1, pair.image2)]
        found = replace(inputs.peer_matches(columns), image_sizes=(photographs[0].size, photographs[1].size))
        counts = (int(columns["features"][0]), int(columns["features"][1]))
        factors = photographs[0].factor, photographs[1].factor
        matches = inputs.PairMatches(sets={peer: (found,)}, features={peer: counts}, pixel_factors=factors)
        before = {"seconds_features": features, "seconds_matching": matching}
        timed = _time_estimators(pair, protocol, matches, group=group, seeds=seeds, before=before)
        records += [record for record, _ in timed]
    return records


def _time_estimators(
    pair: Pair, protocol: Protocol, matches: inputs.PairMatches, *, group: str, seeds: Sequence[int], before: Seconds
) -> Iterator[tuple[TimingRecord, FundamentalEstimate]]:
    """Run every estimator that gets the one input of `matches`; the seconds `before` it are given by column."""
    (name,), truth = matches.sets, pair_truth(pair, protocol.truth)
    key: dict[str, Any] = {"group": group, "pair_id": pair.pair_id, "scene": pair.scene, "input": name, **before}
    key["preprocessed"] = name in inputs.PRESETS
    for estimator in (e for e, names in protocol.inputs.items() if name in names):
        how = protocol.hand_overs[estimator]
        for _, seed, estimate in estimates(matches, pair.pair_id, estimator=estimator, seeds=seeds, hand_overs=how):
            running = sum(estimate.seconds.values())
            own = key | {"seconds_estimator": running, "seconds_total": sum(before.values()) + running}
            error = error_px(estimate.F, truth.x1, truth.x2)
            yield TimingRecord(**own, estimator=estimator, seed=seed, error_px=error), estimate


def _cascade(
    first: tuple[TimingRecord, FundamentalEstimate], second: tuple[TimingRecord, FundamentalEstimate], rule: CascadeRule
) -> TimingRecord:
    """Return the time of the cascade: as the library does, it finds the features that both share only once."""
    (before, estimate), (after, again) = first, second
    if rule.keeps(estimate):
        return replace(before, input=CASCADE)
    parts = ("seconds_matching", "seconds_estimator")
    seconds = {name: getattr(before, name) + getattr(after, name) for name in parts}
    seconds["seconds_features"] = before.seconds_features
    error_px = (before if rule.choose(estimate, again) is estimate else after).error_px
    return replace(after, input=CASCADE, **seconds, seconds_total=sum(seconds.values()), error_px=error_px)
