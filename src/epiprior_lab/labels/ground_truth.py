"""What is true of a pair: which matches are right, the fundamental matrix, and control points.

Where a pair has depth maps, a match is right when each of its points reprojects onto the other and is
visible there; where a homography is given, when it takes them to each other. Else only the epipolar line of the
true F can be checked ("epipolar" labels): 1 to 4 % of random matches satisfy it by chance. The true F is given,
comes from the cameras, or is fitted to all control points.
"""

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from epiprior.geometry import MIN_MATCHES, as_points, eight_point, normalise_fundamental, sampson_distance
from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.pairsets import DatasetError, Pair, covisible, depth_at, reproject, transfer
from epiprior_lab.pairsets.cameras import Cameras, DepthMaps
from epiprior_lab.params import TruthParams

_RIM_REACH_PX = (1.0, 4.0)
_RIM_BEND = 0.1

# Where no parameter file says otherwise.
TRUTH = TruthParams(
    tolerance_px=3.0,
    tolerance_sigma=0.5,
    depth_tolerance=0.02,
    epipolar_px=2.0,
    plane_px=3.0,
    one_plane=None,
    easy_share=0.5,
    hard_share=0.2,
)

_PerImage = tuple[FloatArray, FloatArray]


def label_matches(
    pair: Pair,
    x1: FloatArray,
    x2: FloatArray,
    scale1: FloatArray,
    scale2: FloatArray,
    *,
    settings: TruthParams = TRUTH,
) -> BoolArray:
    """Return which matches `x1`, `x2` (N, 2) of features of sigma `scale1`, `scale2` (N,), pixels, are right, (N,).

    With depth maps: where both reprojections are within ``max(tolerance_px, tolerance_sigma * sigma)`` and the point is
    visible in both images. With a homography: where both transfers are. Else: where the Sampson distance to the true F
    is below `epipolar_px`. A feature at the rim of an object may lie on the background, beside what it describes: where
    a rim is within half a sigma (1 to 4 px), the depth on its other side may confirm it as well. Sky is never right.

    FeatureError if points have a wrong shape; DatasetError if files are damaged or nothing decides.
    """
    x1, x2 = as_points("x1", x1), as_points("x2", x2)
    H = pair.homography()
    if H is not None:
        return _near(H, x1, x2, scale2, settings) & _near(np.asarray(np.linalg.inv(H)), x2, x1, scale1, settings)
    if pair.truth == "epipolar":
        return sampson_distance(reference_fundamental(pair), x1, x2) < settings.epipolar_px
    cameras, depths = pair.depth_views()
    forward = _confirmed(cameras, depths, (x1, x2), (scale1, scale2), settings)
    backward = _confirmed(cameras[::-1], depths[::-1], (x2, x1), (scale2, scale1), settings)
    return forward & backward


def _near(H: FloatArray, x: FloatArray, wanted: FloatArray, scale: FloatArray, settings: TruthParams) -> BoolArray:
    """Return where `H` takes a point close enough to where it should."""
    tolerance = np.maximum(settings.tolerance_px, settings.tolerance_sigma * scale)
    return np.asarray(np.linalg.norm(transfer(H, x) - wanted, axis=1) < tolerance)


def _confirmed(
    cameras: Cameras, depths: DepthMaps, x: _PerImage, scales: _PerImage, settings: TruthParams
) -> BoolArray:
    """Return where a depth of the first image near ``x[0]`` leads to ``x[1]``, at a depth seen there."""
    tolerance = np.maximum(settings.tolerance_px, settings.tolerance_sigma * scales[1])
    beside = _depths_at_rims(depths[1], x[1], scales[1])
    confirmed = np.zeros(len(x[0]), dtype=bool)
    for depth in (depth_at(depths[0], x[0]), *_depths_at_rims(depths[0], x[0], scales[0])):
        known = np.isfinite(depth)
        landed, depth2 = reproject(*cameras, x[0], np.where(known, depth, 1.0))
        near = known & (depth2 > 0) & (np.linalg.norm(landed - x[1], axis=1) < tolerance)
        visible = np.zeros_like(near)
        for other in (depth_at(depths[1], landed), *beside):
            visible |= np.abs(other - depth2) < settings.depth_tolerance * np.abs(depth2)
        confirmed |= near & visible
    return confirmed


def _depths_at_rims(depth: Float32Array, x: FloatArray, scale: FloatArray) -> list[FloatArray]:
    """Return the depths to the right, left, below and above of points, each (N,); inf where no rim is between.

    Inverse depth is linear on a plane, so that a bend of it tells a rim from a slanted surface.
    """
    middle = 1.0 / depth_at(depth, x)
    found = []
    for axis in np.eye(2):
        offset = np.clip(0.5 * scale, *_RIM_REACH_PX)[:, None] * axis
        sides = [depth_at(depth, x + offset), depth_at(depth, x - offset)]
        second, first = 1.0 / sides[0], 1.0 / sides[1]
        bend = np.abs(first + second - 2 * middle) > _RIM_BEND * np.maximum.reduce([first, second, middle])
        found += [np.where(bend, side, np.inf) for side in sides]
    return found


def reference_fundamental(pair: Pair) -> FloatArray:
    """Return the true F of a pair: as given, from its cameras, else fitted to all its control points.

    The fit is the normalised eight-point algorithm, refined to the least Sampson distances, robustly, 1 px (Hartley and
    Zisserman, Multiple View Geometry, 2nd ed., section 11.4.3). On a pair whose control points lie on one plane it is
    one of many F that explain them. DatasetError if the cameras share their centre, a homography is the ground truth,
    or there are fewer than eight control points or they decide nothing.
    """
    F = pair.fundamental()
    if F is None and pair.camera1 is None and pair.homography_path is None:
        x1, x2 = pair.control_points()
        F = fit_to_points(x1, x2)
    if F is None:
        raise DatasetError(f"pair {pair.pair_id!r}: cameras or control points decide no fundamental matrix")
    return F


def fit_to_points(x1: FloatArray, x2: FloatArray) -> FloatArray | None:
    """Return the F of robustly smallest Sampson distances to points (N, 2), pixels; None for fewer than 8."""
    F = eight_point(x1, x2) if len(x1) >= MIN_MATCHES else None
    if F is None:
        return None
    # Both images about their middle and on one scale, so that all parameters matter alike.
    scale = max(float(x1.std()), float(x2.std()), 1e-9)
    middle1, middle2 = x1.mean(axis=0), x2.mean(axis=0)
    T1, T2 = (np.array([[scale, 0, m[0]], [0, scale, m[1]], [0, 0, 1.0]]) for m in (middle1, middle2))
    n1, n2 = (x1 - middle1) / scale, (x2 - middle2) / scale
    U, s, Vt = np.linalg.svd(T2.T @ F @ T1)

    def at(parameters: FloatArray) -> FloatArray:
        turned = (Rotation.from_rotvec(parameters[k : k + 3]).as_matrix() for k in (0, 3))
        return np.asarray(U @ next(turned) @ np.diag([1.0, parameters[6], 0.0]) @ next(turned) @ Vt)

    start = np.append(np.zeros(6), s[1] / s[0])
    found = least_squares(
        lambda parameters: sampson_distance(at(parameters), n1, n2), start, loss="soft_l1", f_scale=1.0 / scale
    )
    return normalise_fundamental(np.linalg.inv(T2).T @ at(found.x) @ np.linalg.inv(T1))


def error_px(F: FloatArray | None, x1: FloatArray, x2: FloatArray) -> float:
    """Return the paper's error of F: the mean Sampson distance of control points (N, 2), pixels; NaN without F."""
    return float("nan") if F is None else float(sampson_distance(F, x1, x2).mean())


def control_points_from_depth(cameras: Cameras, depths: DepthMaps, *, count: int, seed: int) -> _PerImage:
    """Return `count` matched points, spread evenly over all that both images see; fewer where fewer pixels are common.

    They are (N, 2): pixel centres of image 1, drawn within grid cells, and exactly where depth puts them in image 2.
    """
    x1, x2, visible = covisible(cameras, depths)
    x1, x2 = x1[visible], x2[visible]
    if not len(x1):
        return x1, x2
    order = np.random.default_rng(seed).permutation(len(x1))
    # Square cells of such a size that about `count` of them cover the overlap; one point of each, then a second round.
    side = max(1.0, np.sqrt(len(x1) / count))
    rank_in_cell = pd.DataFrame(x1[order] // side).groupby([0, 1]).cumcount()
    chosen = np.sort(order[np.argsort(rank_in_cell, kind="stable")[:count]])
    return x1[chosen], x2[chosen]
