"""Work over pairs: spread over processes or a cluster, each result kept on its own under a content key.

A run that was killed continues where it stopped. The bytes are the same whatever the number of workers and wherever
they are: tasks run with one thread, and arguments and results are pickled, in this process as well.
"""

import contextlib
import os
import pickle
import socket
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import cloudpickle
import joblib
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from epiprior.collection.workers import Pool, open_pool
from epiprior.errors import EpipriorError, SettingsError
from epiprior_lab.compute.store import ResultStore, installation

WORKERS_VARIABLE = "EPIPRIOR_WORKERS"
SCHEDULER_VARIABLE = "EPIPRIOR_SCHEDULER"
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_LOST = f"its worker was killed (out of memory? {WORKERS_VARIABLE} sets their number), or its scheduler was lost"
_SECONDS_BETWEEN_LINES = 10.0
_ONE_AT_A_TIME = threading.RLock()


class TaskError(EpipriorError):
    """A task failed, or the workers were lost; the message names the work, the task and the cause."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One call of the function of `map_tasks`; its name, usually the pair id, is unique within the call.

    The payload holds keyword arguments: None, numbers, strings, bytes, paths, dataclasses, numpy arrays, and lists,
    tuples and dicts of these. `files` are those that the function reads; their contents enter the key.
    """

    name: str
    payload: dict[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()


def default_workers() -> int:
    """Return ``EPIPRIOR_WORKERS`` (SettingsError if not a positive integer), or the cores that this process may use."""
    text = os.environ.get(WORKERS_VARIABLE, "")
    if not text:
        return joblib.cpu_count()  # type: ignore[no-any-return]
    if not text.isdecimal() or int(text) < 1:
        raise SettingsError(f"{WORKERS_VARIABLE} = {text!r}: expected a positive integer")
    return int(text)


def map_tasks(
    function: Callable[..., Any],
    tasks: Sequence[Task],
    *,
    description: str,
    workers: int | None = None,
    store: Path | None = None,
    versions: bool = True,
) -> list[Any]:
    """Call ``function(**task.payload)`` for every task; return the results in the order of the tasks.

    The function is module-level and deterministic, and reads nothing but its arguments and the task's files. It runs in
    `workers` processes, by default `default_workers`, with 1 in this one; or, where ``EPIPRIOR_SCHEDULER`` names one,
    on the workers of a dask scheduler, which need the same installation, and the same files under the same paths.
    `description` names the work in the progress bar and in messages. An interrupt ends workers on this machine at once;
    those of a cluster end their task.

    Only this process writes to the folder `store`, made if absent. It keeps one result per function and task name, used
    again only if its key is the same: function, source of its module and of all that this imports, versions of the
    installed distributions (without `versions` these do not count: the function runs another installation), payload,
    contents of the files. So a run that was interrupted goes on.

    TaskError if a task fails: no more are started, those that were handed out end and are kept, and the error names the
    first one that failed, in the order of the tasks. Also if a file of a task cannot be read, or the workers are lost.
    SettingsError if `workers` is below 1, a name is repeated, a payload has no stable key, or no scheduler answers.
    """
    count = default_workers() if workers is None else workers
    if count < 1:
        raise SettingsError(f"workers = {count}: expected 1 or more")
    repeated = [name for name, times in Counter(task.name for task in tasks).items() if times > 1]
    if repeated:
        raise SettingsError(f"{description}: repeated task name {min(repeated)!r}")
    kept = ResultStore(function, store, versions=versions)
    keys: list[bytes] = []
    results: dict[int, bytes] = {}
    for index, task in enumerate(tasks):
        label = f"{description}: task {task.name!r}"
        try:
            keys.append(kept.key(task.payload, task.files))
        except TypeError as error:
            raise SettingsError(f"{label}: payload: {error}") from error
        except OSError as error:
            raise TaskError(f"{label}: cannot read {error.filename}: {error.strerror}") from error
        if (body := kept.read(task.name, keys[-1])) is not None:
            results[index] = body
    missing = [index for index in range(len(tasks)) if index not in results]
    # Limits hold around the workers too, which inherit them through the environment when they load libraries.
    with (
        _progress(description, len(tasks), len(results)) as advance,
        single_threaded(),
        _open_pool(min(count, len(missing))) as pool,
    ):
        for index, body in _execute(function, tasks, missing, pool, description):
            kept.write(tasks[index].name, keys[index], body)
            results[index] = body
            advance()
    return [pickle.loads(results.pop(index)) for index in range(len(tasks))]


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Limit BLAS, OpenMP, OpenCV and numba to one thread: sums are then taken in one order everywhere."""
    import cv2
    import numba
    import threadpoolctl

    before, threads = dict(os.environ), (cv2.getNumThreads(), numba.get_num_threads())
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))  # for libraries that are loaded from now on
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    try:
        with threadpoolctl.threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(threads[0])
        numba.set_num_threads(threads[1])
        for name in _THREAD_VARIABLES:
            os.environ.pop(name, None)
        os.environ.update({name: before[name] for name in _THREAD_VARIABLES if name in before})


@contextlib.contextmanager
def _open_pool(workers: int) -> Iterator[Pool]:
    """Open the workers of the scheduler, if one is named, or processes; with less than two, this process."""
    scheduler = os.environ.get(SCHEDULER_VARIABLE)
    if scheduler and workers:
        with warnings.catch_warnings(), open_pool(scheduler=scheduler) as pool:
            # A task carries its own arguments; there is no graph that could be smaller.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            yield pool
    elif workers > 1:
        with open_pool(workers) as pool:
            yield pool
    else:
        yield Pool(submit=_submit_here, capacity=lambda: 1)


def _submit_here(function: Callable[..., Any], *args: Any) -> Future[Any]:
    """Call a function at once; an interrupt goes through to the caller."""
    future: Future[Any] = Future()
    try:
        future.set_result(function(*args))
    except Exception as error:  # noqa: BLE001 - whoever asks for the result gets it
        future.set_exception(error)
    return future


def _execute(
    function: Callable[..., Any], tasks: Sequence[Task], missing: Sequence[int], pool: Pool, description: str
) -> Iterator[tuple[int, bytes]]:
    """Yield results as they are ready.

    Tasks are handed out in order and never taken back. When one fails, all before it have therefore been handed out;
    once these ended, the first failure in order is known.
    """
    folder, expected = Path.cwd(), installation() if os.environ.get(SCHEDULER_VARIABLE) else None
    waiting = iter(missing)
    running: dict[Future[bytes], int] = {}
    failures: list[tuple[int, TaskError]] = []
    while True:
        try:
            room = 0 if failures else max(0, pool.capacity() - len(running))
        except OSError as error:
            room, lost = 0, TaskError(f"{description}: {_LOST}: {error}")
            failures.append((-1, lost))
        for index in islice(waiting, room):
            # Pickled here, arguments belong to the task, and its arrays are writable wherever it runs.
            call = cloudpickle.dumps((function, tasks[index].payload))
            label = f"{description}: task {tasks[index].name!r}"
            running[pool.submit(_run, call, label, folder, expected)] = index
        if not running:
            break
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            index = running.pop(future)
            try:
                body = future.result()
            except TaskError as error:
                failures.append((index, error))
            except Exception as error:  # noqa: BLE001 - of a worker, or of a cluster
                failures.append((index, TaskError(f"{description}: task {tasks[index].name!r}: {_LOST}: {error!r}")))
            else:
                yield index, body
    if failures:
        raise min(failures, key=itemgetter(0))[1]


def _run(call: bytes, label: str, folder: Path, expected: bytes | None) -> bytes:
    """Run one task with one thread, and return its result pickled."""
    # Thread limits and working folder belong to the process, and a worker of a cluster may have several threads.
    with _ONE_AT_A_TIME, single_threaded():
        try:
            with contextlib.chdir(folder):
                if expected is not None and installation() != expected:
                    where = f"worker {os.getpid()} on {socket.gethostname()}"
                    raise SettingsError(f"{where} has other code or other versions than the process that sent the task")
                function, payload = cloudpickle.loads(call)
                return pickle.dumps(function(**payload), protocol=5)
        except Exception as error:
            raise TaskError(f"{label} failed: {type(error).__name__}: {error}") from error


@contextlib.contextmanager
def _progress(description: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on a terminal, or elsewhere writes a line every ten seconds."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    start = last = time.monotonic()
    count = done

    def line(end: str = "") -> None:
        if not console.is_terminal:
            sys.stderr.write(f"{description}: {count} of {total} after {time.monotonic() - start:.0f} s{end}\n")

    with Progress(*columns, *times, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(description, total=total, completed=done)

        def advance() -> None:
            nonlocal count, last
            count += 1
            progress.advance(bar)
            if time.monotonic() - last >= _SECONDS_BETWEEN_LINES:
                last = time.monotonic()
                line()

        yield advance
    line(f", {done} from the store")
