"""How kernels are compiled: on one thread, kept on disk where that can be, announced where it takes a while."""

import functools
import logging
from collections.abc import Callable
from typing import Any

import numba
from numba.core.caching import FunctionCache

logger = logging.getLogger(__name__)


class _OptionalCache(FunctionCache):
    """Numba's cache of one kernel on disk, without which everything works: damaged files are compiled anew."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel; None where there is none, or none that can be read: it is compiled then."""
        loaded = None
        try:
            loaded = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001 - whatever a damaged pickle raises
            logger.warning("damaged cache of the compiled kernel %s, compiled anew: %r", self._name, error)
            self._unless_it_fails(self.flush)
        if loaded is None:
            _announce()
        return loaded

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, if that can be."""
        self._unless_it_fails(super().save_overload, sig, data)

    @staticmethod
    def _unless_it_fails(work: Callable[..., object], *arguments: Any) -> None:
        try:
            work(*arguments)
        except Exception as error:  # noqa: BLE001 - a full disk, an index that another process damaged
            logger.debug("the cache of compiled kernels: %r", error)


def compiled(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function at its first call: ``numba.njit`` without Python's lock, and with a cache on disk.

    Where neither the folder of the module nor the user's cache can be written, numba has no place for its cache: the
    kernels are then compiled anew in every process, and a warning says so once. `options` are those of ``numba.njit``.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(nogil=True, **options)(function)
        try:
            kernel._cache = _OptionalCache(kernel.py_func)  # type: ignore[no-untyped-call]  # as enable_caching does
        except (RuntimeError, OSError):  # numba: no locator available
            _warn_of_no_cache()
        return kernel

    return decorate if function is None else decorate(function)


@functools.cache  # once per process
def _announce() -> None:
    logger.info("compiling kernels: the first call on this machine takes up to a minute")


@functools.cache  # once per process
def _warn_of_no_cache() -> None:
    logger.warning(
        "no folder for compiled kernels can be written: they are compiled anew in every process; "
        "set NUMBA_CACHE_DIR to a folder that can"
    )
