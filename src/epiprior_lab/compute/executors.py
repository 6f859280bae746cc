"""Where tasks run: in this process, in processes beside it, or on a dask cluster; all behind one interface."""

import contextlib
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from typing import Any

from joblib.externals.loky import get_reusable_executor

from epiprior.collection.workers import connect_scheduler
from epiprior.errors import EpipriorError, SettingsError

_IDLE_SECONDS = 300  # workers stay for the next work, with all that they have imported and compiled
_FIRST_WORKER_SECONDS = 60
_PARENT_CHECK_SECONDS = 1.0


@dataclass(frozen=True, kw_only=True)
class Pool:
    """An executor, and how many tasks should be submitted and not yet done: ``capacity()``, ``>= 1``.

    So many that no worker waits, and memory stays bounded; BrokenExecutor if the workers are lost. Workers of a
    `remote` pool were started by somebody else, perhaps with other code, in another folder.
    """

    executor: Executor
    capacity: Callable[[], int]
    remote: bool


def open_pool(*, workers: int, scheduler: str | None) -> contextlib.AbstractContextManager[Pool]:
    """Open workers for one piece of work: of a dask scheduler, or processes (with 0 or 1, this process).

    An exception inside, other than an EpipriorError, ends processes beside this one at once, tasks in flight included;
    a cluster is told to forget the tasks. SettingsError if the address is none, no scheduler answers, it has no worker,
    or ``distributed`` is not installed.
    """
    if scheduler is not None:
        return _on_cluster(scheduler)
    if workers > 1:
        return _in_processes(workers)
    return contextlib.nullcontext(Pool(executor=_InThisProcess(), capacity=lambda: 1, remote=False))


class _InThisProcess(Executor):
    """Run a task when it is submitted; an interrupt goes through to the caller."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - whoever asks for the result gets it
            future.set_exception(error)
        return future


@contextlib.contextmanager
def _in_processes(workers: int) -> Iterator[Pool]:
    with warnings.catch_warnings():
        # loky replaces a worker whose memory grew between two tasks. No task is lost, and there is nothing to do.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        executor = get_reusable_executor(
            max_workers=workers, timeout=_IDLE_SECONDS, initializer=_follow_parent, initargs=(os.getpid(),)
        )
        try:
            yield Pool(executor=executor, capacity=lambda: 2 * workers, remote=False)
        except EpipriorError:  # of a task, when all others have ended
            raise
        except BaseException:
            executor.shutdown(wait=True, kill_workers=True)
            raise


def _follow_parent(parent: int) -> None:
    """Leave interrupts to the parent, which ends its workers, and end if the parent was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECK_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _on_cluster(address: str) -> Iterator[Pool]:
    with connect_scheduler(address) as client, warnings.catch_warnings():
        try:
            client.wait_for_workers(1, timeout=_FIRST_WORKER_SECONDS)
        except TimeoutError as error:
            raise SettingsError(f"scheduler = {address!r}: no worker within {_FIRST_WORKER_SECONDS} s") from error
        # A task carries its own arguments; there is no graph that could be smaller.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        executor = client.get_executor(pure=False)

        def capacity() -> int:
            try:  # workers may come and go
                return 2 * max(1, len(client.nthreads()))
            except OSError as error:
                raise BrokenExecutor(f"no connection to the scheduler: {error}") from error

        try:
            yield Pool(executor=executor, capacity=capacity, remote=True)
        except BaseException:
            executor.shutdown(wait=False)
            raise
