"""OpenCV's USAC framework: ``usac``, ``magsac++`` and ``gc-ransac``.

All three sample progressively (PROSAC), so the order of the matches is the prior they use. The random draw depends on
``UsacParams.randomGeneratorState`` only; ``cv2.setRNGSeed`` does nothing here. Works with OpenCV 4.13 and later, and
with 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from epiprior.estimators.protocol import EstimatorSettings, RawModel
from epiprior.types import FloatArray, MatchSet


@dataclass(frozen=True, kw_only=True)
class OpenCVEstimator:
    """One configuration of ``cv2.UsacParams``.

    Parameters
    ----------
    name : Name in the registry.
    score, local_optimisation, polisher : OpenCV's ``SCORE_METHOD_*``, ``LOCAL_OPTIM_*`` and ``*_POLISHER`` constants.
    max_iterations : Cap on the hypotheses. A compromise: on standard matches of 128 real pairs caps of 5,000, 20,000
        and 100,000 gave 108.5, 110 and 111.5 successes (10 px) at a mean of 9, 17 and 56 ms; on short, well ordered
        lists there was no difference.

    ``usac`` follows the example for F that comes with the USAC 1.0 release as far as OpenCV can: PROSAC, local
    optimisation by inner samples of 15 repeated 5 times followed by iterations, 1.5 px, confidence 0.99. OpenCV runs
    SPRT inside and has no switch for it; its check of degenerate samples is its own.
    """

    name: str
    score: int
    local_optimisation: int
    polisher: int
    licence: str = "Apache-2.0"
    max_iterations: int = 20_000

    def missing(self) -> str:
        """Return an empty string: OpenCV is a dependency of epiprior."""
        return ""

    def version(self) -> str:
        """Return OpenCV's version."""
        return f"opencv {cv2.__version__}"

    def fit(self, matches: MatchSet, *, seed: int, settings: EstimatorSettings) -> RawModel:
        """Run ``cv2.findFundamentalMat``; OpenCV tells no iteration count."""
        params = cv2.UsacParams()
        params.sampler = cv2.SAMPLING_PROSAC
        params.score = self.score
        params.loMethod = self.local_optimisation
        params.loSampleSize = 15
        params.loIterations = 5
        params.final_polisher = self.polisher
        params.threshold = settings.threshold_px
        params.confidence = settings.confidence
        params.maxIterations = settings.max_iterations or self.max_iterations
        params.randomGeneratorState = seed
        params.isParallel = False
        return RawModel(F=_find(matches.x1, matches.x2, params))


def _find(x1: FloatArray, x2: FloatArray, params: cv2.UsacParams) -> FloatArray | None:
    """Return OpenCV's matrix, or None where it returns none or throws; its mask is never looked at."""
    try:
        F, _ = cv2.findFundamentalMat(x1, x2, params)
    except cv2.error:
        return None
    return None if F is None else np.asarray(F, dtype=np.float64)


ESTIMATORS = (
    OpenCVEstimator(
        name="usac",
        score=cv2.SCORE_METHOD_MSAC,
        local_optimisation=cv2.LOCAL_OPTIM_INNER_AND_ITER_LO,
        polisher=cv2.LSQ_POLISHER,
    ),
    OpenCVEstimator(
        name="magsac++", score=cv2.SCORE_METHOD_MAGSAC, local_optimisation=cv2.LOCAL_OPTIM_SIGMA, polisher=cv2.MAGSAC
    ),
    OpenCVEstimator(
        name="gc-ransac", score=cv2.SCORE_METHOD_MSAC, local_optimisation=cv2.LOCAL_OPTIM_GC, polisher=cv2.LSQ_POLISHER
    ),
)
