"""Step 4b, beyond the paper: whether the matches around a match move as it does.

A 2keypoint has one neighbour. Coherence takes many, further away: of the features around a match, how many have a
candidate that lies where the match's own similarity transformation takes it? Right matches of a surface agree with each
other; a window that was taken for the next one agrees with the other features of that window only.

References: agreement with the neighbourhood is what GMS (Bian et al., CVPR 2017) counts by cells and AdaLAM (Cavalli et
al., ECCV 2020) by local affine maps, both among one candidate per feature. Weighing many of each feature is ours.
"""

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.kernels.parallel import in_chunks
from epiprior.presets import COHERENCE_COLUMNS
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.neighbourhoods import nearest_points
from epiprior.types import FloatArray, IntArray

NEAR, FAR = 12, 48
REACH_PX, LEAST_PX = 300.0, 2.0
TOLERANCE = 0.4
_LEAST_WEIGHT = 0.02
_DOUBT = 0.5
_CHUNK = 2_000


def coherence(frames: MatchFrames, location1: IntArray, weights: FloatArray) -> FloatArray:
    """Return how far the matches around each match agree with it, shape (M, 4): `COHERENCE_COLUMNS`.

    Column 1: over the 12 nearest locations of image 1 that have a candidate, the sum of the best candidate's weight
    times its agreement. Column 2: this sum over that of the highest weights plus 0.5, so that few neighbours count
    less. Columns 3 and 4: the same over the 48 nearest. `weights` say how probable each match is by itself, in [0, 1];
    candidates are the matches of at least 0.02.

    A match at ``x1 -> x2`` expects the neighbour at ``x1 + v`` at ``x2 + s R v``, where R turns by the roll hypothesis
    and s is the geometric mean of both matches' scale changes. With e the distance from there over ``s |v|``, the
    agreement of a candidate is ``1 - (e / 0.4)^2``, and 0 beyond. Neighbours count from 2 to 300 working pixels. Where
    the match's own location has no candidate, 13 and 49 locations count.
    """
    out = np.zeros((len(frames), len(COHERENCE_COLUMNS)))
    candidates = np.flatnonzero(weights >= _LEAST_WEIGHT)
    candidates = candidates[np.argsort(location1[candidates], kind="stable")]
    places, first = np.unique(location1[candidates], return_index=True)
    if len(places) < 2:
        return out
    start = np.append(first, len(candidates)).astype(np.int64)
    own, row = np.unique(location1, return_index=True)
    # One more than wanted, since a location is its own nearest; its distance of zero is below the least that counts.
    _, near = nearest_points(frames.x1[candidates[first]], frames.x1[row], FAR + 1)
    turn = np.array([np.cos(frames.roll_rad), np.sin(frames.roll_rad)])
    root_scale = np.sqrt(frames.scale2 / frames.scale1)
    of_match = np.searchsorted(own, location1)
    sides = (frames.x1, frames.x2, root_scale, turn, weights, of_match, near, NEAR + 1, candidates, start)
    in_chunks(lambda part: _agreements(part.start, *sides, out[part]), len(frames), _CHUNK)
    return out


@compiled(error_model="numpy")
def _agreements(first, x1, x2, root_scale, turn, weights, of_match, near, near_count, candidates, start, out):  # type: ignore[no-untyped-def]
    """Write the columns of the matches from `first` on, as many as `out` has rows."""
    for row in range(len(out)):
        m = first + row
        agreement = 0.0
        most = 0.0
        for e in range(near.shape[1]):
            if e == near_count:
                out[row, 0] = agreement
                out[row, 1] = agreement / (most + _DOUBT)
            place = near[of_match[m], e]
            v0 = x1[candidates[start[place]], 0] - x1[m, 0]
            v1 = x1[candidates[start[place]], 1] - x1[m, 1]
            length_sq = v0 * v0 + v1 * v1
            if not LEAST_PX * LEAST_PX <= length_sq <= REACH_PX * REACH_PX:
                continue
            best = 0.0
            highest = 0.0
            for q in range(start[place], start[place + 1]):
                n = candidates[q]
                highest = max(highest, weights[n])
                s = root_scale[m] * root_scale[n]
                d0 = x2[n, 0] - x2[m, 0] - s * (turn[0] * v0 - turn[1] * v1)
                d1 = x2[n, 1] - x2[m, 1] - s * (turn[1] * v0 + turn[0] * v1)
                share = (d0 * d0 + d1 * d1) / (s * s * length_sq * TOLERANCE * TOLERANCE)
                if share < 1.0:
                    best = max(best, weights[n] * (1.0 - share))
            agreement += best
            most += highest
        out[row, 2] = agreement
        out[row, 3] = agreement / (most + _DOUBT)
        if near.shape[1] <= near_count:
            out[row, 0], out[row, 1] = out[row, 2], out[row, 3]


def descriptor_weights(
    location1: IntArray, location2: IntArray, similarity: FloatArray, distance_ratio: FloatArray
) -> FloatArray:
    """Return rough probabilities of matches by their descriptors alone, before any classifier; all of shape (M,).

    The similarity counts from 0 to 1 where it is from 0.5 to 0.9, shared by the candidates of a location; d_r (1 where
    it is missing) counts from 0 to 1 where it is from 1 to 0.6. The larger of both is taken.
    """
    if not len(location1):
        return np.empty(0)
    candidates = np.maximum(np.bincount(location1)[location1], np.bincount(location2)[location2])
    by_similarity = np.clip((similarity - 0.5) / 0.4, 0.0, 1.0) / candidates
    return np.asarray(np.maximum(by_similarity, np.clip((1.0 - distance_ratio) / 0.4, 0.0, 1.0)))
