"""The local frames of putative matches: location, scale and orientation of both features, and how alike they look."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from epiprior.kernels.compilation import compiled
from epiprior.kernels.descriptor import inner_product
from epiprior.matching.pair import PreparedPair
from epiprior.types import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class MatchFrames:
    """One row per putative match; lengths in working pixels, angles in radians.

    Of several SIFT orientations at a location, those two are taken whose descriptors are most alike.
    """

    x1: FloatArray  # (M, 2)
    x2: FloatArray  # (M, 2)
    scale1: FloatArray  # (M,), sigma
    scale2: FloatArray  # (M,), sigma
    orientation1_rad: FloatArray  # (M,)
    orientation2_rad: FloatArray  # (M,)
    similarity: FloatArray  # (M,), of the descriptors at these orientations, in [-1, 1]
    fixed_similarity: FloatArray  # (M,), of those at the fixed orientations of the roll hypothesis
    roll_rad: float  # the roll hypothesis

    def __len__(self) -> int:
        return len(self.x1)

    @property
    def roll_error(self) -> FloatArray:
        """Deviation of each match's turn from the roll hypothesis, radians in [0, pi]."""
        turn = self.orientation2_rad - self.orientation1_rad - self.roll_rad
        return np.asarray(np.abs(np.angle(np.exp(1j * turn))))

    @property
    def scale_change(self) -> FloatArray:
        """Log of the scale of image 2 over that of image 1."""
        return np.asarray(np.log(self.scale2 / self.scale1))

    def take(self, index: IntArray | BoolArray) -> MatchFrames:
        """Return the rows at `index`, in that order."""
        rows = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name != "roll_rad"}
        return replace(self, **rows)


@compiled
def _most_alike(rows1, rows2, twins1, start1, twins2, start2, d1, d2):  # type: ignore[no-untyped-def]
    """For each pair of locations, the two features that are most alike, and their similarity."""
    best1 = np.empty(len(rows1), np.int64)
    best2 = np.empty(len(rows1), np.int64)
    similarity = np.empty(len(rows1), np.float64)
    for m in range(len(rows1)):
        best = np.float32(-np.inf)
        for i in twins1[start1[rows1[m]] : start1[rows1[m] + 1]]:
            for j in twins2[start2[rows2[m]] : start2[rows2[m] + 1]]:
                v = inner_product(d1[i], d2[j])
                if v > best:
                    best = v
                    best1[m], best2[m] = i, j
        similarity[m] = best
    return best1, best2, similarity


@compiled
def _paired_similarity(rows1, rows2, d1, d2):  # type: ignore[no-untyped-def]
    out = np.empty(len(rows1), np.float64)
    for m in range(len(rows1)):
        out[m] = inner_product(d1[rows1[m]], d2[rows2[m]])
    return out


def match_frames(
    prepared: PreparedPair, rows1: IntArray, rows2: IntArray, fixed: tuple[Float32Array, Float32Array], roll_deg: float
) -> MatchFrames:
    """Collect the frames of the matches of locations `rows1` with `rows2`, shape (M,) each.

    `fixed` holds the unit descriptors of every location of both images at the fixed orientations.
    """
    (l1, l2), (f1, f2) = prepared.locations, prepared.features
    twins = (l1.twins, l1.start, l2.twins, l2.start)
    best1, best2, similarity = _most_alike(rows1, rows2, *twins, *prepared.descriptors)
    return MatchFrames(
        x1=l1.xy[rows1],
        x2=l2.xy[rows2],
        scale1=l1.scale[rows1],
        scale2=l2.scale[rows2],
        orientation1_rad=np.deg2rad(f1.orientation_deg[best1]),
        orientation2_rad=np.deg2rad(f2.orientation_deg[best2]),
        similarity=similarity,
        fixed_similarity=_paired_similarity(rows1, rows2, *fixed),
        roll_rad=float(np.deg2rad(roll_deg)),
    )
