"""Where tasks run: in processes beside this one, or on the workers of a dask cluster.

A worker is a fresh interpreter that takes calls on its standard input; it ends when that is closed, so also when this
process is killed. Unlike those of multiprocessing, it does not run the user's script again. Every task has one thread:
results are the same bytes for any number of workers.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from epiprior.errors import EpipriorError, SettingsError
from epiprior.settings_file import find_settings_file

Key = TypeVar("Key")
Job = tuple[Key, tuple[Any, ...]]
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM")}
_SECONDS_TO_CONNECT = 30


class WorkerError(EpipriorError):
    """A task failed by a bug, or its worker was lost; the message has the traceback or says what was in flight."""


class WorkerLostError(WorkerError):
    """A worker ended while it had a task."""


@dataclass(frozen=True, kw_only=True)
class Pool:
    """How a call is handed out, and how many should be on their way: no worker waits, and memory stays bounded."""

    submit: Callable[..., Future[Any]]
    capacity: Callable[[], int]


@contextlib.contextmanager
def open_pool(workers: int | None = None, scheduler: str | None = None) -> Iterator[Pool]:
    """Open `workers` processes (None: as many as this process may use cores), or the workers of a dask `scheduler`.

    After an exception inside, processes end at once; a cluster is told to forget the tasks. SettingsError if `workers`
    is below 1, ``distributed`` is not installed, or no scheduler answers.
    """
    if scheduler is not None:
        with _on_cluster(scheduler) as pool:
            yield pool
        return
    count = _cores() if workers is None else workers
    if count < 1:
        raise SettingsError(f"workers = {count}: expected 1 or more")
    local, started = threading.local(), list[subprocess.Popen[bytes]]()

    def start() -> None:
        local.process = _start()
        started.append(local.process)

    def ask(*call: Any) -> Any:
        return _ask(local.process, call)

    executor = ThreadPoolExecutor(count, initializer=start)
    try:
        yield Pool(submit=lambda *call: executor.submit(ask, *call), capacity=lambda: 2 * count)
    except BaseException:
        for process in started:
            process.kill()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        for process in started:
            with contextlib.suppress(OSError):
                process.communicate()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start() -> subprocess.Popen[bytes]:
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)  # noqa: PTH100 - the empty one too
    environment = {**os.environ, **_ONE_THREAD, "PYTHONPATH": paths}
    command = [sys.executable, "-m", "epiprior.collection.workers"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)


def _ask(process: subprocess.Popen[bytes], call: tuple[Any, ...]) -> Any:
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        pickle.dump(call, process.stdin, protocol=5)
        process.stdin.flush()
        value = pickle.load(process.stdout)
    except (EOFError, OSError, pickle.UnpicklingError) as error:
        raise WorkerLostError("a worker was killed, perhaps because memory ran out: give fewer workers") from error
    if isinstance(value, Exception):
        raise value
    return value


def run_tasks(pool: Pool, function: Callable[..., Any], jobs: Iterable[Job[Key]]) -> Iterator[tuple[Key, Any]]:
    """Yield the key and the result of ``function(*args)`` for every ``(key, args)``, as they are ready.

    The function is found by its module and name. An error of a task ends the work once those on their way have ended.
    """
    waiting = iter(jobs)
    running: dict[Future[Any], Key] = {}
    failure: BaseException | None = None
    while True:
        room = 0 if failure else max(0, pool.capacity() - len(running))
        for key, args in islice(waiting, room):
            running[pool.submit(run_alone, installation(), function, args)] = key
        if not running:
            break
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            key = running.pop(future)
            if (error := future.exception()) is None:
                yield key, future.result()
            elif failure is None:
                failure = error if isinstance(error, EpipriorError) else WorkerError(f"{key}: {error}")
    if failure is not None:
        raise failure


@functools.cache
def installation() -> str:
    """Return a digest of the version, the source and the models of epiprior, as they are when first asked for."""
    digest = hashlib.sha256(metadata.version("epiprior").encode())
    package = Path(__file__).resolve().parents[1]
    files = sorted(package.rglob("*.py"))
    if (rule := find_settings_file("cascade.json")) is not None:
        files += sorted(path for path in rule.parent.rglob("*") if path.is_file() and path.suffix in (".json", ".onnx"))
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()


_alone = threading.Lock()


def run_alone(expected: str, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Call a function in a worker, one at a time, with OpenCV on one thread; a bug comes back as a WorkerError.

    SettingsError if the installation of the worker is not the `expected` one.
    """
    import cv2

    if installation() != expected:
        raise SettingsError(f"worker {os.getpid()} on {socket.gethostname()} has another epiprior: start it anew")
    with _alone:
        cv2.setNumThreads(1)
        try:
            return function(*args)
        except EpipriorError:
            raise
        except Exception as error:  # noqa: BLE001 - the traceback is of this process, and goes along
            raise WorkerError(f"{error!r}\n{traceback.format_exc()}") from None


def connect_scheduler(address: str) -> Any:
    """Return a client of a dask scheduler; SettingsError if dask is not installed or none answers at `address`."""
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    except ImportError as error:
        raise SettingsError(f"scheduler = {address!r}: needs distributed: pip install 'epiprior[cluster]'") from error
    try:
        # Asked before dask is: a client without a scheduler leaves a thread behind that later ones may wait for.
        socket.create_connection(get_address_host_port(address), _SECONDS_TO_CONNECT).close()
        return Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise SettingsError(f"scheduler = {address!r}: no dask scheduler answers there: {error}") from error


@contextlib.contextmanager
def _on_cluster(address: str) -> Iterator[Pool]:
    with connect_scheduler(address) as client:
        executor = client.get_executor(pure=False)
        try:
            yield Pool(submit=executor.submit, capacity=lambda: 2 * max(1, len(client.nthreads())))
        except BaseException:
            executor.shutdown(wait=False)
            raise


def _serve() -> None:
    """Take calls from standard input until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no reply
    while True:
        try:
            function, *args = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            reply = function(*args)
        except Exception as error:  # noqa: BLE001 - whoever asked gets it
            reply = error
        try:
            pickle.dump(reply, replies, protocol=5)
            replies.flush()
        except BrokenPipeError:  # the parent was killed
            os._exit(1)


if __name__ == "__main__":
    _serve()
