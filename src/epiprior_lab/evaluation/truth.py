"""What is known of a pair: points to measure at, an F to hold against, how its matches are labelled, how hard it is.

How hard follows from the ground truth alone, the share of right matches in X_L: successes would select the result.
"""

import contextlib
from dataclasses import dataclass

import cv2
import numpy as np

from epiprior.types import FloatArray
from epiprior_lab.evaluation.distances import points_on_lines
from epiprior_lab.labels.ground_truth import reference_fundamental
from epiprior_lab.pairsets import DatasetError, Pair, transfer_distance
from epiprior_lab.params import TruthParams

_BESIDE_PLANE = 3
_BESIDE_PLANE_SHARE = 0.05
_GRID = 10
_GOLDEN_RATIO = 0.6180339887498949
_LABELS = {"3D": "depth", "plane": "plane", "epipolar": "epipolar"}


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The ground truth of a pair; `labels` and `points` as in `epiprior_lab.evaluation.records.PairRecord`.

    `x1`, `x2`, shape (N, 2), are the points at which an estimate is measured, pixels. `F` is None where nothing
    decides it: a homography is given, or all control points lie on one plane.
    """

    labels: str
    points: str
    x1: FloatArray
    x2: FloatArray
    F: FloatArray | None


def pair_truth(pair: Pair, settings: TruthParams) -> Truth:
    """Return the ground truth of a pair; its control points are read.

    DatasetError if the pair has neither control points nor cameras nor an F, or a file is damaged.
    """
    x1, x2 = evaluation_points(pair)
    F = None  # also of too few control points, or one centre of both cameras
    fitted = pair.camera1 is None and pair.fundamental_path is None
    flat = fitted and (pair.pair_id in (settings.one_plane or ()) or on_one_plane(x1, x2, settings.plane_px))
    if pair.homography_path is None and not flat:
        with contextlib.suppress(DatasetError):
            F = reference_fundamental(pair)
    labels = _LABELS[pair.truth]
    if labels == "epipolar":
        labels = "" if F is None else "control_points" if fitted else labels
    points = "cameras" if pair.control_points_path is None else "control_points"
    return Truth(labels=labels, points=points, x1=x1, x2=x2, F=F)


def on_one_plane(x1: FloatArray, x2: FloatArray, threshold_px: float) -> bool:
    """Return whether points, (N, 2), follow one homography within a distance but for a few, so that they decide no F.

    Two points beside the plane would do for an F without noise; we ask for three, and for a twentieth of all.
    """
    if len(x1) < 5:
        return True
    H, _ = cv2.findHomography(x1, x2, cv2.RANSAC, threshold_px)
    if H is None:
        return False
    beside = int(np.count_nonzero(~(transfer_distance(np.asarray(H, np.float64), x1, x2) < threshold_px)))
    return beside < max(_BESIDE_PLANE, _BESIDE_PLANE_SHARE * len(x1))


def evaluation_points(pair: Pair) -> tuple[FloatArray, FloatArray]:
    """Return the control points of a pair, or where it has none, points that its cameras or its F allow.

    Without control points it is unknown what the two images share. A regular grid of points of image 1 is then paired
    with points on their true epipolar lines, spread over the part of each line that image 2 shows. DatasetError if the
    pair has no control points, cameras or F, or no epipolar line meets image 2.
    """
    if pair.control_points_path is not None:
        return pair.control_points()
    if pair.fundamental_path is None and (pair.camera1 is None or pair.camera2 is None):
        raise DatasetError(f"pair {pair.pair_id!r}: neither control points nor cameras")
    F = reference_fundamental(pair)
    size1, size2 = pair.sizes()
    steps = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(steps * size1[0], steps * size1[1])
    x1 = np.column_stack([x.ravel(), y.ravel()])
    lines = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    share: FloatArray = np.arange(len(x1), dtype=np.float64) * _GOLDEN_RATIO % 1.0  # spreads the points over the lines
    x2, met = points_on_lines(lines, size2, share)
    if not met.any():
        raise DatasetError(f"pair {pair.pair_id!r}: no epipolar line of image 1 meets image 2")
    return x1[met], x2[met]


def true_roll_deg(pair: Pair) -> float:
    """Return the roll between the cameras, degrees in (-180, 180]; NaN without cameras.

    The angle of the rotation closest to the upper left 2 x 2 block of the relative rotation: how directions near the
    optical axis turn in the image, clockwise as seen on the screen.
    """
    if pair.camera1 is None or pair.camera2 is None:
        return float("nan")
    R = pair.camera2.R @ pair.camera1.R.T
    return float(np.degrees(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])))
