"""Estimators of other packages: OpenCV's, and those that are installed beside epiprior. Each is run on one thread.

- ``usac``, ``magsac++`` and ``gc-ransac``: OpenCV's USAC framework, from 4.13 on, and 5. All three sample progressively
  (PROSAC), so the order of the matches is the prior they use. The random draw depends on
  ``UsacParams.randomGeneratorState`` only; ``cv2.setRNGSeed`` does nothing here. ``usac`` follows the example for F
  that comes with the USAC 1.0 release as far as OpenCV can: PROSAC, local optimisation by inner samples of 15 repeated
  5 times followed by iterations, 1.5 px, confidence 0.99. OpenCV runs SPRT inside and has no switch for it; its check
  of degenerate samples is its own.
- ``prosac`` and ``lo-ransac``: PoseLib's LO-RANSAC, with progressive sampling and without; ``colmap``: COLMAP's
  LO-RANSAC through pycolmap; ``degensac``: DEGENSAC through pydegensac. All but ``prosac`` take no prior: what helps
  them is a short hand-over. Points are passed with our pixel origin, so F comes back in it too: COLMAP's half pixel is
  no concern here.
"""

from functools import partial

import cv2

from epiprior.estimators.protocol import CONFIDENCE, Estimator, Run
from epiprior.types import MatchSet

_MIN_ITERATIONS = 100
_MSAC, _MAGSAC = cv2.SCORE_METHOD_MSAC, cv2.SCORE_METHOD_MAGSAC
_INNER, _SIGMA, _GRAPH_CUT = cv2.LOCAL_OPTIM_INNER_AND_ITER_LO, cv2.LOCAL_OPTIM_SIGMA, cv2.LOCAL_OPTIM_GC


def _usac(
    score: int, local_optimisation: int, polisher: int, matches: MatchSet, threshold_px: float, cap: int, seed: int
) -> tuple[object, None]:
    """Run ``cv2.findFundamentalMat`` with OpenCV's constants for score, local optimisation and last polish."""
    params = cv2.UsacParams()
    params.sampler, params.score, params.final_polisher = cv2.SAMPLING_PROSAC, score, polisher
    params.loMethod, params.loSampleSize, params.loIterations = local_optimisation, 15, 5
    params.threshold, params.confidence, params.maxIterations = threshold_px, CONFIDENCE, cap
    params.randomGeneratorState = seed
    params.isParallel = False
    try:
        return cv2.findFundamentalMat(matches.x1, matches.x2, params)[0], None  # the mask may be garbage
    except cv2.error:
        return None, None


def _poselib(
    progressive: bool, matches: MatchSet, threshold_px: float, cap: int, seed: int
) -> tuple[object, int | None]:
    """Run PoseLib: a failure is a matrix of NaN. Its own minimum of 1,000 hypotheses costs time, for nothing."""
    import poselib

    options = {
        "progressive_sampling": progressive,
        "max_epipolar_error": threshold_px,
        "success_prob": CONFIDENCE,
        "max_iterations": cap,
        "min_iterations": min(_MIN_ITERATIONS, cap),
        "seed": seed,
    }
    F, info = poselib.estimate_fundamental(matches.x1, matches.x2, options, {})
    return F, int(info["iterations"])


def _degensac(matches: MatchSet, threshold_px: float, cap: int, seed: int) -> tuple[object, None]:
    """Run pydegensac: a failure is a matrix of zeros. A negative seed would draw from the clock; ours never is."""
    import pydegensac  # type: ignore[import-not-found, unused-ignore]

    options = {"error_type": "sampson", "enable_degeneracy_check": True, "max_iters": cap, "seed": seed}
    F, _ = pydegensac.findFundamentalMatrix(matches.x1, matches.x2, px_th=threshold_px, conf=CONFIDENCE, **options)
    return F, None


def _colmap(matches: MatchSet, threshold_px: float, cap: int, seed: int) -> tuple[object, None]:
    import pycolmap

    options = pycolmap.RANSACOptions(
        max_error=threshold_px,
        confidence=CONFIDENCE,
        min_num_trials=min(_MIN_ITERATIONS, cap),
        max_num_trials=cap,
        random_seed=seed,
        num_threads=1,
    )
    answer = pycolmap.estimate_fundamental_matrix(matches.x1, matches.x2, options)
    return None if answer is None else answer["F"], None


# Package, what to install, what runs, the cap on the hypotheses, the licence. The caps are compromises. OpenCV's: on
# standard matches of 128 real pairs caps of 5,000, 20,000 and 100,000 gave 108.5, 110 and 111.5 successes (10 px) at a
# mean of 9, 17 and 56 ms; on short, well ordered lists there was no difference. PoseLib stops by the plain RANSAC bound
# even when it samples progressively, and so runs to the cap whenever inliers are rare: 5,000 cost 30 ms on 300 matches
# and 0.4 s on 6,000. COLMAP's 10,000 cost 0.1 s on 300 matches.
_BACKENDS: dict[str, tuple[str, str, Run, int, str]] = {
    "usac": ("cv2", "", partial(_usac, _MSAC, _INNER, cv2.LSQ_POLISHER), 20_000, "Apache-2.0"),
    "magsac++": ("cv2", "", partial(_usac, _MAGSAC, _SIGMA, cv2.MAGSAC), 20_000, "Apache-2.0"),
    "gc-ransac": ("cv2", "", partial(_usac, _MSAC, _GRAPH_CUT, cv2.LSQ_POLISHER), 20_000, "Apache-2.0"),
    "prosac": ("poselib", "epiprior[poselib]", partial(_poselib, True), 5_000, "BSD-3-Clause"),
    "lo-ransac": ("poselib", "epiprior[poselib]", partial(_poselib, False), 5_000, "BSD-3-Clause"),
    "degensac": ("pydegensac", "epiprior[degensac]", _degensac, 20_000, "MIT"),
    "colmap": ("pycolmap", "pycolmap>=4", _colmap, 10_000, "BSD-3-Clause"),
}
ESTIMATORS = tuple(
    Estimator(name=name, package=package, requirement=needed, run=run, max_iterations=cap, licence=licence)
    for name, (package, needed, run, cap, licence) in _BACKENDS.items()
)
