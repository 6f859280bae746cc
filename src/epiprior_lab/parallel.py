"""Work over pairs: spread over processes, each result kept on its own under a content key.

A run that was killed continues where it stopped. The bytes are the same whatever the number of workers: every
task runs with one thread, and every result passes through pickle, in the one-worker case as well.
"""

import contextlib
import copy
import functools
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import joblib
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from epiprior.errors import EpipriorError, SettingsError
from epiprior_lab.task_store import ContentKeys, read_result, result_path, write_result

WORKERS_VARIABLE = "EPIPRIOR_WORKERS"
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_SECONDS_BETWEEN_LINES = 10.0


class TaskError(EpipriorError):
    """A task failed; the message names the work, the task and the cause."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One call of the function of `map_tasks`.

    Attributes
    ----------
    name : str
        Unique within the call, usually the pair id.
    payload : dict
        Keyword arguments of the function: None, numbers, strings, bytes, paths, dataclasses, numpy arrays,
        and lists, tuples and dicts of these.
    files : tuple of Path
        Files that the function reads; their contents enter the key.
    """

    name: str
    payload: dict[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()


def default_workers() -> int:
    """Return the number of workers: ``EPIPRIOR_WORKERS``, or the cores that this process may use.

    Raises
    ------
    SettingsError
        If the variable is not a positive integer.
    """
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
) -> list[Any]:
    """Call ``function(**task.payload)`` for every task.

    Parameters
    ----------
    function : callable
        A module-level function; deterministic, reads nothing but its arguments and the task's files.
    tasks : sequence of Task
        May be empty. Names are unique.
    workers : int
        Processes, ``>= 1``; with 1 the tasks run in this process.
    description : str
        What the progress bar and error messages call this work.
    store : Path, optional
        Folder of results, made if absent. It keeps one result per function and task name, and uses it again
        only if its key is the same: function, source of its module and of all that this imports, versions of
        the installed distributions, payload, contents of the files. Give presets and families a folder each.

    Returns
    -------
    list
        Results in the order of the tasks.

    Raises
    ------
    TaskError
        If a task fails, or one of its files cannot be read. Results that were ready stay in the store.
    SettingsError
        If `workers` is below one, a name is repeated, or a payload holds something that has no stable key.
    """
    if workers < 1:
        raise SettingsError(f"workers = {workers}: expected 1 or more")
    names = [task.name for task in tasks]
    repeated = {name for name in names if names.count(name) > 1} if len(set(names)) < len(names) else set()
    if repeated:
        raise SettingsError(f"{description}: repeated task name {min(repeated)!r}")
    keys = ContentKeys(function)
    results: list[Any] = [None] * len(tasks)
    jobs = []
    for index, task in enumerate(tasks):
        job = _Job(
            index=index,
            function=function,
            task=task,
            key=_key(keys, task, description),
            path=None if store is None else result_path(store, function, task.name),
            description=description,
        )
        body = None if job.path is None else read_result(job.path, job.key)
        if body is None:
            jobs.append(job)
        else:
            results[index] = pickle.loads(body)
    if store is not None:
        store.mkdir(parents=True, exist_ok=True)
    # Limits hold around the workers too: they inherit them through the environment when they load libraries.
    with _progress(description, len(tasks), len(tasks) - len(jobs)) as advance, single_threaded():
        for index, body in _execute(jobs, min(workers, len(jobs))):
            results[index] = pickle.loads(body)
            advance()
    return results


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Limit BLAS, OpenMP, OpenCV and numba to one thread: sums are then taken in one order everywhere."""
    import cv2
    import numba
    import threadpoolctl

    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    threads = cv2.getNumThreads(), numba.get_num_threads()
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))  # for libraries that are loaded from now on
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    try:
        with threadpoolctl.threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(threads[0])
        numba.set_num_threads(threads[1])
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A task whose result is not in the store; `path` is where it goes, if anywhere."""

    index: int
    function: Callable[..., Any]
    task: Task
    key: bytes
    path: Path | None
    description: str


def _key(keys: ContentKeys, task: Task, description: str) -> bytes:
    try:
        return keys.key(task.payload, task.files)
    except TypeError as error:
        raise SettingsError(f"{description}: payload of task {task.name!r}: {error}") from error
    except OSError as error:
        message = f"cannot read {error.filename}: {error.strerror}"
        raise TaskError(f"{description}: task {task.name!r}: {message}") from error


def _execute(jobs: list[_Job], workers: int) -> Iterator[tuple[int, bytes]]:
    """Yield results as they are ready."""
    if workers <= 1:
        yield from (_run(copy.deepcopy(job)) for job in jobs)  # tasks own their arguments, as in processes
        return
    # Arrays are not memory-mapped: a task would see a read-only array with many workers and not with one.
    parallel = joblib.Parallel(
        n_jobs=workers, backend="loky", return_as="generator_unordered", batch_size=1, max_nbytes=None
    )
    yield from parallel(joblib.delayed(_run)(job) for job in jobs)


def _run(job: _Job) -> tuple[int, bytes]:
    """Run one task with one thread, keep its result, and return it pickled."""
    with single_threaded():
        try:
            result = job.function(**job.task.payload)
        except Exception as error:
            message = f"task {job.task.name!r} failed: {type(error).__name__}: {error}"
            raise TaskError(f"{job.description}: {message}") from error
    body = pickle.dumps(result, protocol=5)
    if job.path is not None:
        write_result(job.path, job.key, body)
    return job.index, body


# --- progress


@contextlib.contextmanager
def _progress(description: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Yield a function that advances a bar on a terminal, or writes a line every ten seconds elsewhere."""
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
            bar = progress.add_task(description, total=total, completed=done)
            yield functools.partial(progress.advance, bar)
        return
    start = last = time.monotonic()
    count = done

    def advance() -> None:
        nonlocal count, last
        count += 1
        now = time.monotonic()
        if now - last >= _SECONDS_BETWEEN_LINES:
            last = now
            sys.stderr.write(f"{description}: {count} of {total} after {now - start:.0f} s\n")

    yield advance
    sys.stderr.write(
        f"{description}: {total} of {total} after {time.monotonic() - start:.0f} s, {done} from the store\n"
    )
