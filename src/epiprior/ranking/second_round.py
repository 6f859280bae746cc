"""Step 7b, beyond the paper: the most probable matches are judged again, now that all have a first probability.

The classifier of section 4.6 sees each match alone. With the first probabilities much more is known: whether the
neighbours that are probable agree with it, in both images; how probable its rivals are; how far it is from the few F
that the probable matches support best, and what these F are worth without it; and what the pair looks like as a whole.

References: auto-context, a classifier on the output of the one before: Tu and Bai, PAMI 2010. The columns are ours.
"""

from dataclasses import replace

import numpy as np

from epiprior.geometry import SHRINKING_THRESHOLDS_PX, Evidence, as_columns, different_models, sampson_distance
from epiprior.kernels.local_steps import refine_models
from epiprior.kernels.one_to_one import one_to_one_mask
from epiprior.presets import SECOND_ROUND_COLUMNS
from epiprior.ranking.coherence import coherence
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.probabilities import MatchTable, Union, best_rival
from epiprior.types import FloatArray, IntArray

_HEAD = 800  # one-to-one matches that choose and refine F
_REFINED = 40  # so many of the rough matrices are refined
_KEPT = 3  # so many different ones have a column
_COARSE_PX, _FINE_PX, _SUPPORT_PX, _FAR_PX = 6.0, 2.0, 3.0, 100.0
_SAME_SHARE = 0.75  # intersection over union of the supporters from which on two F are the same
_TOP = 100


def second_round_rows(probability: FloatArray, count: int) -> IntArray:
    """Return the rows of the `count` most probable matches, most probable first."""
    return np.argsort(-probability, kind="stable")[:count]


def second_round_table(
    rows: IntArray, union: Union, frames: MatchFrames, table: MatchTable, probability: FloatArray, matrices: FloatArray
) -> MatchTable:
    """Describe matches for the second round: kpmd and what the first probabilities tell, `SECOND_ROUND_COLUMNS`.

    `rows`, (N,), are the matches to describe, as `second_round_rows` returns them; `union`, `frames`, `table` and
    `probability` all matches, their frames, kpmd and first probabilities; `matrices`, (P, 3, 3), the rough F, working
    pixels.
    """
    p, own = probability[rows], frames.take(rows)
    location1, location2 = union.location1[rows], union.location2[rows]
    swapped = replace(
        own, x1=own.x2, x2=own.x1, scale1=own.scale2, scale2=own.scale1, roll_rad=-own.roll_rad
    )  # fmt: skip
    single = rows[one_to_one_mask(location1, location2)]
    x1, x2, weights = frames.x1[single], frames.x2[single], probability[single]
    models = _leading_models(matrices, x1[:_HEAD], x2[:_HEAD], weights[:_HEAD])
    evidence = Evidence(x1, x2, weights).scores(models, _FINE_PX)
    order = np.argsort(-evidence, kind="stable")
    models, evidence = models[order], evidence[order]
    distance = np.array([sampson_distance(F, own.x1, own.x2) for F in models]).reshape(len(models), len(rows))
    leaders = different_models(enumerate(distance < _FINE_PX), _KEPT, _SAME_SHARE)
    near = np.full((_KEPT, len(rows)), _FAR_PX)
    near[: len(leaders)] = np.minimum(distance[leaders], _FAR_PX)
    # What each F is worth without the match itself, which would otherwise confirm it.
    without = np.maximum(evidence[:, None] - p * np.maximum(1.0 - (distance / _FINE_PX) ** 2, 0.0), 0.0)
    without = np.where(distance < _SUPPORT_PX, without, 0.0)
    best = max(float(evidence.max(initial=0.0)), 1e-12)
    second = float(evidence[leaders[1]]) if len(leaders) > 1 else 0.0
    total = float(weights.sum())
    mean = float(weights[:_TOP].mean()) if len(single) else 0.0
    pair = (np.log1p(total), mean, best / max(total, 1e-12), second / best)
    columns = [
        p,
        np.log1p(np.arange(len(rows))),
        best_rival(probability, union.location1)[rows],
        best_rival(probability, union.location2)[rows],
        *coherence(own, location1, p).T,
        *coherence(swapped, location2, p).T,
        *np.log1p(near),
        without.sum(axis=0) / max(float(evidence.sum()), 1e-12),
        without.max(axis=0, initial=0.0) / best,
        *(np.full(len(rows), value) for value in pair),
    ]
    added = np.column_stack(columns).astype(np.float32)
    return MatchTable(SECOND_ROUND_COLUMNS, np.hstack([table.descriptors[rows], added]))


def _leading_models(matrices: FloatArray, x1: FloatArray, x2: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the rough matrices with the highest sums of probabilities, refined on these matches, best first."""
    scores = Evidence(x1, x2, weights).scores(matrices, _COARSE_PX)
    order = np.argsort(-scores, kind="stable")[:_REFINED]
    models = np.ascontiguousarray(matrices[order[scores[order] > 0]])
    refine_models(models, as_columns(x1, x2), weights, np.array(SHRINKING_THRESHOLDS_PX))
    return models
