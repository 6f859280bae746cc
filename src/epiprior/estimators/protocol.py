"""What an estimator is: a name, what runs it, and how many hypotheses it may draw."""

import functools
import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata

from epiprior.types import MatchSet

CONFIDENCE = 0.99  # wanted probability of having drawn a sample without outliers
SEED_LIMIT = 2**31 - 1

# Takes at least 8 distinct, finite matches, best first; the inlier threshold on the unsquared Sampson distance, pixels;
# the cap on the hypotheses drawn; and the seed in [0, SEED_LIMIT). Returns F, unchecked, None if there is none, and the
# number of hypotheses drawn, None where the backend does not tell. It is deterministic given the seed, may use of the
# matches what it can (order, probability, scale, orientation, rough matrices), and does not raise where they are bad.
Run = Callable[[MatchSet, float, int, int], tuple[object, int | None]]


@dataclass(frozen=True, kw_only=True)
class Estimator:
    """One robust estimator of the fundamental matrix, by default one that needs epiprior alone."""

    name: str  # in the registry
    run: Run
    max_iterations: int  # cap on the hypotheses drawn
    package: str = "epiprior"  # is imported
    requirement: str = ""  # for `pip install`, where the package is optional
    licence: str = "BSD-3-Clause"  # of what runs
    deterministic: bool = False  # whether the seed changes nothing

    def missing(self) -> str:
        """Return what to install, or an empty string if the estimator can run."""
        here = not self.requirement or importlib.util.find_spec(self.package)
        return "" if here else f'pip install "{self.requirement}"'

    def version(self) -> str:
        """Return the backend's package and version."""
        return package_version(self.package)


@functools.cache  # parsing the metadata takes milliseconds, and every estimate carries a version
def package_version(package: str) -> str:
    """Return ``package version`` as installed, or `package` alone where it carries no metadata."""
    if package == "cv2":  # of several distributions
        return f"opencv {importlib.import_module(package).__version__}"
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return package
