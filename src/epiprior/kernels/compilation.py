"""Tell the user when kernels have to be compiled: once per machine and version, since numba keeps them on disk."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

logger = logging.getLogger(__name__)


def announce_compilation(kernel: Any, of: str, wait: str) -> None:
    """Log at INFO, once per process and kernel, if a compiled kernel is not in numba's cache yet.

    Parameters
    ----------
    kernel : dispatcher of numba
        Stands for all kernels that are compiled along with it.
    of : str
        What they belong to.
    wait : str
        How long that takes on an ordinary machine.
    """
    if kernel in _asked:
        return
    _asked.add(kernel)
    if kernel.signatures:
        return
    try:
        module, name = kernel.py_func.__module__.rpartition(".")[2], kernel.py_func.__qualname__
        cached = any(Path(str(kernel.stats.cache_path)).glob(f"{module}.{name}-*.nbi"))
    except (AttributeError, TypeError, OSError):
        cached = False
    if not cached:
        logger.info("compiling kernels of %s: the first call on this machine takes %s", of, wait)


_asked: set[Any] = set()
