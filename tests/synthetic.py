"""Synthetic matches of two cameras with known F, for tests of everything after the matching."""

from dataclasses import dataclass, replace

import numpy as np

from epiprior.estimators import find_estimator, registry
from epiprior.estimators.handover import HandOver
from epiprior.estimators.run import estimate_from_matches
from epiprior.geometry import normalise_fundamental, sampson_distance
from epiprior.matching.putative import PutativeMatches
from epiprior.ranking.frames import MatchFrames
from epiprior.types import BoolArray, FloatArray, FundamentalEstimate, MatchSet, Status

WIDTH, HEIGHT, FOCAL = 1024, 768, 900.0
K = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class SyntheticPair:
    """Matches, which of them are right, the true F and noise-free control points."""

    matches: MatchSet
    right: BoolArray
    F: FloatArray
    control1: FloatArray
    control2: FloatArray

    def error_px(self, F: FloatArray | None) -> float:
        """The paper's measure: mean root Sampson distance at the control points; inf without F."""
        return np.inf if F is None else float(sampson_distance(F, self.control1, self.control2).mean())


def rotation(axis, degrees):
    a = np.asarray(axis) / np.linalg.norm(axis)
    S = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    t = np.deg2rad(degrees)
    return np.eye(3) + np.sin(t) * S + (1 - np.cos(t)) * S @ S


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])


def project(X, R, t):
    Y = (X @ R.T + t) @ K.T
    return Y[:, :2] / Y[:, 2:]


def scene_points(scene, n, rng, off_plane):
    """World points 8 to 12 units before both cameras."""
    X = rng.uniform([-4, -3, -2], [4, 3, 2], (n, 3))
    if scene in ("plane", "plane+"):
        on = np.arange(n) >= off_plane
        X[on, 2] = 0.3 * X[on, 0] - 0.2 * X[on, 1]
        X[~on, 2] = rng.uniform(-3.0, -1.5, int((~on).sum()))
    if scene == "line":
        X = np.array([0.2, -0.3, 0.0]) + rng.uniform(-3.5, 3.5, (n, 1)) * np.array([[1.0, 0.4, 0.15]])
    X[:, 2] += 10.0
    return X


def make_matches(x1, x2, probability=None, **columns):
    """A MatchSet in the given order; every match has its own two features unless told otherwise."""
    n = len(x1)
    zeros = np.zeros(n)
    values = dict.fromkeys(("scale1", "scale2"), np.full(n, 3.0))
    values |= dict.fromkeys(("orientation1_deg", "orientation2_deg"), zeros)
    values |= dict.fromkeys(("feature1", "feature2"), np.arange(n))
    values |= dict.fromkeys(("similarity_weight", "two_keypoint_probability"), zeros)
    values |= {"similarity": np.full(n, 0.9), "distance_ratio": np.linspace(0.5, 0.9, n)}
    values["supporting_matrices"] = np.zeros(n, np.int64)
    values["probability"] = np.full(n, np.nan) if probability is None else probability
    return MatchSet(x1=np.asarray(x1, float), x2=np.asarray(x2, float), **(values | columns))


def make_pair(*, scene="relief", inliers=200, outliers=100, noise_px=0.5, order=3.0, off_plane=30, seed=0):
    """Make matches of a scene, sorted by a probability that knows the truth to a degree.

    `order` is the distance, in standard deviations, of the log odds of right and wrong matches: 0 is a random
    order, 3 a good one. `scene` is relief, plane, line, ``rotation``, of which the second camera only turns, or
    ``plane+``, which puts `off_plane` of the inliers before the plane.
    """
    rng = np.random.default_rng(seed)
    R = rotation((0.1, 1.0, 0.05), 12.0)
    t = -R @ (np.zeros(3) if scene == "rotation" else np.array([2.2, 0.3, -0.4]))
    off = off_plane if scene == "plane+" else 0
    X = scene_points(scene, 4 * inliers + 600, rng, 4 * off)
    parts = []
    for chunk, wanted in ((X[: 4 * off], off), (X[4 * off :], inliers - off)):
        p1, p2 = project(chunk, np.eye(3), np.zeros(3)), project(chunk, R, t)
        seen = ((p1 >= 0) & (p1 < [WIDTH, HEIGHT]) & (p2 >= 0) & (p2 < [WIDTH, HEIGHT])).all(axis=1)
        parts.append((p1[seen][:wanted], p2[seen][:wanted]))
    x1, x2 = (np.concatenate(side) for side in zip(*parts, strict=True))
    assert len(x1) == inliers
    y1 = np.concatenate([x1 + rng.normal(0, noise_px, x1.shape), rng.uniform(0, [WIDTH, HEIGHT], (outliers, 2))])
    y2 = np.concatenate([x2 + rng.normal(0, noise_px, x2.shape), rng.uniform(0, [WIDTH, HEIGHT], (outliers, 2))])
    right = np.arange(len(y1)) < inliers
    prior = np.log((inliers + 1) / (outliers + 1))
    logit = rng.normal(np.where(right, order / 2, -order / 2), 1.0) * max(order, 1.0) + prior
    walk = np.argsort(-logit, kind="stable")
    Ki = np.linalg.inv(K)
    direction = t if np.linalg.norm(t) > 0 else np.array([1.0, 0, 0])
    F = normalise_fundamental(Ki.T @ skew(direction) @ R @ Ki)
    assert F is not None
    control = scene_points("relief", 400, np.random.default_rng(seed + 1), 0)
    matches = make_matches(y1[walk], y2[walk], 1 / (1 + np.exp(-logit[walk])))
    return SyntheticPair(matches, right[walk], F, project(control, np.eye(3), np.zeros(3)), project(control, R, t))


def run(name, matches, *, seed=0):
    """Run an estimator on all of the matches as they are."""
    return estimate_from_matches([matches], estimator=name, seed=seed, hand_over=HandOver())


def cap(monkeypatch, name, max_iterations):
    """Let an estimator draw no more hypotheses."""
    monkeypatch.setitem(registry._REGISTRY, name, replace(find_estimator(name), max_iterations=max_iterations))


def random_scene(seed, n=60, clusters=8):
    """Locations, scales and clusters of the features of an image; two of them are twins."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 100, (n, 2))
    xy[5] = xy[6]
    return xy, rng.uniform(0.8, 4, n), rng.integers(0, clusters, n)


def make_estimate(pair, status=Status.OK, **changes):
    """The estimate that knows the truth of a pair, or one without F."""
    x1, x2, F = pair.matches.x1, pair.matches.x2, pair.F
    if status is not Status.OK:
        F, changes = None, {"inliers": np.zeros(len(x1), bool), "support": 0} | changes
    known = {"status": status, "F": F, "x1": x1, "x2": x2, "inliers": pair.right, "support": int(pair.right.sum())}
    about = {"estimator": "usac", "version": "opencv 5", "input": "default"}
    return FundamentalEstimate(**(known | about | changes))


def make_frames(x1, x2, **columns):
    """The frames of matches; what is not given is 1, an angle 0."""
    one = np.ones(len(x1))
    values = dict.fromkeys(("scale1", "scale2", "similarity", "fixed_similarity"), one)
    values |= {"orientation1_rad": 0 * one, "orientation2_rad": 0 * one, "roll_rad": 0.0}
    return MatchFrames(x1=np.asarray(x1, float), x2=np.asarray(x2, float), **(values | columns))


def make_putative(pairs, n1, n2):
    first, second = np.array(sorted(pairs), np.int64).reshape(-1, 2).T.copy()
    counts = np.bincount(first, minlength=n1)
    return PutativeMatches(first, second, np.append(0, np.cumsum(counts)), counts, np.bincount(second, minlength=n2))


def unit_rows(rng, n, d):
    """Random descriptors of length 1, float32 (n, d)."""
    x = rng.normal(size=(n, d)).astype(np.float32)
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def on_epipolar_lines(F, x1, seed=0):
    """Points of image 2 anywhere on the epipolar lines of points of image 1."""
    line = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    u = np.random.default_rng(seed).uniform(0, WIDTH, len(x1))
    return np.column_stack([u, -(line[:, 0] * u + line[:, 2]) / line[:, 1]])


def same_matrix(A, B, tolerance=1e-7):
    """Whether two matrices are one but for factor and sign."""
    A, B = A / np.linalg.norm(A), B / np.linalg.norm(B)
    return bool(min(np.abs(A - B).max(), np.abs(A + B).max()) < tolerance)
