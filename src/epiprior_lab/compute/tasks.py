"""Work over pairs: spread over processes or a cluster, each result kept on its own under a content key.

A run that was killed continues where it stopped. The bytes are the same whatever the number of workers and wherever
they are: tasks run with one thread, and arguments and results are pickled, in this process as well.
"""

import contextlib
import functools
import os
import pickle
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import cloudpickle
import joblib
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from epiprior.errors import EpipriorError, SettingsError
from epiprior_lab.compute.executors import Pool, open_pool
from epiprior_lab.compute.store import ContentKeys, Installation, read_result, result_path, write_result

WORKERS_VARIABLE = "EPIPRIOR_WORKERS"
SCHEDULER_VARIABLE = "EPIPRIOR_SCHEDULER"
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
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
    workers: int,
    description: str,
    store: Path | None = None,
    scheduler: str | None = None,
    versions: bool = True,
) -> list[Any]:
    """Call ``function(**task.payload)`` for every task; return the results in the order of the tasks.

    The function is module-level and deterministic, and reads nothing but its arguments and the task's files. It runs in
    `workers` processes, with 1 in this one, or on the workers of a dask `scheduler`, such as ``tcp://host:8786``, by
    default that of ``EPIPRIOR_SCHEDULER``; these need the same installation, and the same files under the same paths.
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
    if workers < 1:
        raise SettingsError(f"workers = {workers}: expected 1 or more")
    repeated = [name for name, count in Counter(task.name for task in tasks).items() if count > 1]
    if repeated:
        raise SettingsError(f"{description}: repeated task name {min(repeated)!r}")
    keys = ContentKeys(function, versions=versions)
    results: list[Any] = [None] * len(tasks)
    jobs = []
    for index, task in enumerate(tasks):
        label = f"{description}: task {task.name!r}"
        try:
            key = keys.key(task.payload, task.files)
        except TypeError as error:
            raise SettingsError(f"{label}: payload: {error}") from error
        except OSError as error:
            raise TaskError(f"{label}: cannot read {error.filename}: {error.strerror}") from error
        path = None if store is None else result_path(store, function, task.name)
        body = None if path is None else read_result(path, key)
        if body is None:
            jobs.append(_Job(index=index, task=task, label=label, key=key, path=path))
        else:
            results[index] = pickle.loads(body)
    if store is not None:
        store.mkdir(parents=True, exist_ok=True)
    scheduler = (scheduler or os.environ.get(SCHEDULER_VARIABLE) or None) if jobs else None
    # Limits hold around the workers too, which inherit them through the environment when they load libraries.
    with (
        _progress(description, len(tasks), len(tasks) - len(jobs)) as advance,
        single_threaded(),
        open_pool(workers=min(workers, len(jobs)), scheduler=scheduler) as pool,
    ):
        installation = keys.installation if pool.remote else None
        for job, body in _execute(function, jobs, pool, description, installation):
            if job.path is not None:
                write_result(job.path, job.key, body)
            results[job.index] = pickle.loads(body)
            advance()
    return results


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


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A task whose result is not in the store; `path` is where it goes, if anywhere."""

    index: int
    task: Task
    label: str
    key: bytes
    path: Path | None


def _execute(
    function: Callable[..., Any], jobs: Sequence[_Job], pool: Pool, description: str, installation: Installation | None
) -> Iterator[tuple[_Job, bytes]]:
    """Yield results as they are ready.

    Tasks are handed out in order and never taken back. When one fails, all before it have therefore been handed out;
    once these ended, the first failure in order is known.
    """
    folder = Path.cwd()
    waiting = iter(jobs)
    running: dict[Future[bytes], _Job] = {}
    failures: list[tuple[int, TaskError]] = []
    while True:
        try:
            room = 0 if failures else max(0, pool.capacity() - len(running))
            for job in islice(waiting, room):
                # Pickled here, arguments belong to the task, and its arrays are writable wherever it runs.
                call = cloudpickle.dumps((function, job.task.payload))
                running[pool.executor.submit(_run, call, job.label, folder, installation)] = job
        except BrokenExecutor:
            failures.append((-1, _lost(running.values(), description)))
        if not running:
            break
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            job = running[future]
            try:
                body = future.result()
            except (BrokenExecutor, CancelledError):
                failures.append((-1, _lost(running.values(), description)))
            except Exception as error:  # noqa: BLE001 - of the task, or of a cluster that gave it up
                failures.append((job.index, _failure(job.label, error)))
            else:
                yield job, body
            del running[future]
    if failures:
        raise min(failures, key=itemgetter(0))[1]


def _lost(jobs: Iterable[_Job], description: str) -> TaskError:
    names = ", ".join(repr(job.task.name) for job in jobs)
    return TaskError(
        f"{description}: workers were killed (perhaps memory ran out: {WORKERS_VARIABLE} sets their number), or "
        f"their scheduler was lost; in flight were {names}; what was ready is kept"
    )


def _run(call: bytes, label: str, folder: Path, installation: Installation | None) -> bytes:
    """Run one task with one thread, and return its result pickled."""
    # Thread limits and working folder belong to the process, and a worker of a cluster may have several threads.
    with _ONE_AT_A_TIME, single_threaded():
        try:
            with contextlib.chdir(folder):
                if installation is not None and not installation.is_here():
                    where = f"worker {os.getpid()} on {socket.gethostname()}"
                    raise SettingsError(f"{where} has other code or other versions than the process that sent the task")
                function, payload = cloudpickle.loads(call)
                return pickle.dumps(function(**payload), protocol=5)
        except Exception as error:
            raise _failure(label, error) from error


def _failure(label: str, error: Exception) -> TaskError:
    return error if isinstance(error, TaskError) else TaskError(f"{label} failed: {type(error).__name__}: {error}")


@contextlib.contextmanager
def _progress(description: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on a terminal, or elsewhere writes a line every ten seconds."""
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
            bar = progress.add_task(description, total=total, completed=done)
            yield functools.partial(progress.advance, bar)
        return
    start = last = time.monotonic()
    count = done

    def line(end: str) -> None:
        sys.stderr.write(f"{description}: {count} of {total} after {time.monotonic() - start:.0f} s{end}\n")

    def advance() -> None:
        nonlocal count, last
        count += 1
        if time.monotonic() - last >= _SECONDS_BETWEEN_LINES:
            last = time.monotonic()
            line("")

    yield advance
    line(f", {done} from the store")
