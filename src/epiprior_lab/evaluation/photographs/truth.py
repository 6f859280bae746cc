"""What is known of a pair of photographs: points to measure at, an F to hold against, how hard the pair is.

Splits follow from the ground truth alone: the share of right matches in X_L, the paper's standard matches. An
estimator's success would select for the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.evaluation.photographs.points import evaluation_points
from epiprior_lab.labels.ground_truth import reference_fundamental
from epiprior_lab.pairsets import DatasetError, Pair, transfer_distance

SPLITS = ("easy", "medium", "hard")
UNLABELLED = "unlabelled"
_BESIDE_PLANE = 3
_BESIDE_PLANE_SHARE = 0.05


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The ground truth of a pair, as the evaluation uses it.

    Parameters
    ----------
    labels : str
        What decides whether a match is right: ``3D``, ``plane``, ``epipolar``, or ``none``.
    points : str
        ``control_points``; or ``cameras`` where there are none, and points on true epipolar lines stand for them.
    x1, x2 : ndarray, shape (N, 2), float64
        Points at which an estimate is measured, pixels.
    F : ndarray, shape (3, 3), or None
        None where nothing decides it: a homography is given, or all control points lie on one plane.
    """

    labels: str
    points: str
    x1: FloatArray
    x2: FloatArray
    F: FloatArray | None


def pair_truth(pair: Pair, *, plane_px: float, one_plane: Sequence[str] = ()) -> Truth:
    """Return the ground truth of a pair.

    Parameters
    ----------
    pair : Pair
        Its control points are read.
    plane_px : float
        Control points that near one homography lie on one plane.
    one_plane : sequence of str
        Ids of pairs whose control points lie on one plane, whatever this makes of them.

    Raises
    ------
    DatasetError
        If the pair has neither control points nor cameras nor an F, or a file is damaged.
    """
    x1, x2 = evaluation_points(pair)
    F = None
    fitted = pair.camera1 is None and pair.fundamental_path is None
    flat = fitted and (pair.pair_id in one_plane or on_one_plane(x1, x2, plane_px))
    if pair.homography_path is None and not flat:
        try:
            F = reference_fundamental(pair)
        except DatasetError:
            F = None  # too few control points, or one centre of both cameras
    labels = pair.truth if F is not None or pair.truth != "epipolar" else "none"
    points = "cameras" if pair.control_points_path is None else "control_points"
    return Truth(labels=labels, points=points, x1=x1, x2=x2, F=F)


def on_one_plane(x1: FloatArray, x2: FloatArray, threshold_px: float) -> bool:
    """Return whether points follow one homography but for a few, so that they decide no F.

    Parameters
    ----------
    x1, x2 : ndarray, shape (N, 2), float64
        Control points, pixels.
    threshold_px : float
        Largest distance in either image.

    Notes
    -----
    Two points beside the plane would do for an F without noise; we ask for three, and for a twentieth of all.
    """
    if len(x1) < 5:
        return True
    H, _ = cv2.findHomography(x1, x2, cv2.RANSAC, threshold_px)
    if H is None:
        return False
    beside = int(np.count_nonzero(~(transfer_distance(np.asarray(H, np.float64), x1, x2) < threshold_px)))
    return beside < max(_BESIDE_PLANE, _BESIDE_PLANE_SHARE * len(x1))


def split_of(share: float, *, easy: float, hard: float) -> str:
    """Return how hard a pair is by the share of right matches in X_L; `UNLABELLED` where it is NaN."""
    if np.isnan(share):
        return UNLABELLED
    if share > easy:
        return "easy"
    return "hard" if share < hard else "medium"
