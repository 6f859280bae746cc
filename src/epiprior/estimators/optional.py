"""Estimators of packages that are installed beside epiprior: ``prosac``, ``lo-ransac``, ``colmap``, ``degensac``.

PoseLib's LO-RANSAC, with progressive sampling (``prosac``) and without; COLMAP's LO-RANSAC through pycolmap; DEGENSAC
through pydegensac. All but ``prosac`` take no prior: what helps them is a short hand-over. Points are passed with our
pixel origin, so F comes back in it too: COLMAP's half pixel is no concern here.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from epiprior.estimators.protocol import Estimator, EstimatorSettings, RawModel, package_version
from epiprior.types import MatchSet

_MIN_ITERATIONS = 100

# Takes matches, settings, the cap on the hypotheses and the seed; returns F, if any, and the number drawn, if known.
Run = Callable[[MatchSet, EstimatorSettings, int, int], tuple[object, int | None]]


@dataclass(frozen=True, kw_only=True)
class OptionalEstimator(Estimator):
    """An estimator that another package runs."""

    package: str  # is imported
    requirement: str  # for `pip install`
    run: Run

    def missing(self) -> str:
        """Return what to install, or an empty string."""
        return "" if importlib.util.find_spec(self.package) else f'pip install "{self.requirement}"'

    def version(self) -> str:
        """Return the package's version."""
        return package_version(self.package)

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Run the package, on one thread."""
        F, drawn = self.run(matches, settings, settings.max_iterations or self.max_iterations, seed)
        return RawModel(F=None if F is None else np.asarray(F, dtype=np.float64), iterations=drawn)


def _poselib(
    progressive: bool, matches: MatchSet, settings: EstimatorSettings, cap: int, seed: int
) -> tuple[object, int | None]:
    """Run PoseLib: a failure is a matrix of NaN. Its own minimum of 1,000 hypotheses costs time, for nothing."""
    import poselib

    options = {
        "progressive_sampling": progressive,
        "max_epipolar_error": settings.threshold_px,
        "success_prob": settings.confidence,
        "max_iterations": cap,
        "min_iterations": min(_MIN_ITERATIONS, cap),
        "seed": seed,
    }
    F, info = poselib.estimate_fundamental(matches.x1, matches.x2, options, {})
    return F, int(info["iterations"])


def _degensac(matches: MatchSet, settings: EstimatorSettings, cap: int, seed: int) -> tuple[object, int | None]:
    """Run pydegensac: a failure is a matrix of zeros. A negative seed would draw from the clock; ours never is."""
    import pydegensac  # type: ignore[import-not-found, unused-ignore]

    options = {"error_type": "sampson", "enable_degeneracy_check": True, "max_iters": cap, "seed": seed}
    F, _ = pydegensac.findFundamentalMatrix(
        matches.x1, matches.x2, px_th=settings.threshold_px, conf=settings.confidence, **options
    )
    return F, None


def _colmap(matches: MatchSet, settings: EstimatorSettings, cap: int, seed: int) -> tuple[object, int | None]:
    import pycolmap

    options = pycolmap.RANSACOptions(
        max_error=settings.threshold_px,
        confidence=settings.confidence,
        min_num_trials=min(_MIN_ITERATIONS, cap),
        max_num_trials=cap,
        random_seed=seed,
        num_threads=1,
    )
    answer = pycolmap.estimate_fundamental_matrix(matches.x1, matches.x2, options)
    return None if answer is None else answer["F"], None


# PoseLib stops by the plain RANSAC bound even when it samples progressively, and so runs to the cap whenever inliers
# are rare: 5,000 cost 30 ms on 300 matches and 0.4 s on 6,000. COLMAP's 10,000 cost 0.1 s on 300 matches.
_BACKENDS: dict[str, tuple[str, str, Run, int, str]] = {
    "prosac": ("poselib", "epiprior[poselib]", partial(_poselib, True), 5_000, "BSD-3-Clause"),
    "lo-ransac": ("poselib", "epiprior[poselib]", partial(_poselib, False), 5_000, "BSD-3-Clause"),
    "degensac": ("pydegensac", "epiprior[degensac]", _degensac, 20_000, "MIT"),
    "colmap": ("pycolmap", "pycolmap>=4", _colmap, 10_000, "BSD-3-Clause"),
}
ESTIMATORS = tuple(
    OptionalEstimator(name=name, package=package, requirement=needed, run=run, max_iterations=cap, licence=licence)
    for name, (package, needed, run, cap, licence) in _BACKENDS.items()
)
