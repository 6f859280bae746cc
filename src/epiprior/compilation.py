"""Tell the user when kernels have to be compiled: once per machine and version, since numba keeps them on disk."""

from __future__ import annotations

import logging
from pathlib import Path

from epiprior import votes

logger = logging.getLogger(__name__)


def announce_compilation() -> None:
    """Log at INFO, once per process, if the compiled kernels are not in numba's cache yet."""
    if _announced:
        return
    _announced.append(True)
    kernel = votes._count_votes
    if kernel.signatures:
        return
    try:
        folder = Path(str(kernel.stats.cache_path))
        cached = any(folder.glob("votes._count_votes-*.nbi"))
    except (AttributeError, TypeError, OSError):
        cached = False
    if not cached:
        logger.info("compiling kernels: the first call on this machine takes about half a minute")


_announced: list[bool] = []
