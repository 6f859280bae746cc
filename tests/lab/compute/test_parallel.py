"""Tasks: order, stored results and their keys, failures, stopped runs, threads."""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cloudpickle
import cv2
import numba
import numpy as np
import psutil
import pytest
import threadpoolctl

from epiprior.errors import SettingsError
from epiprior_lab.compute import tasks as parallel
from epiprior_lab.compute.store import ResultStore, installation
from epiprior_lab.compute.tasks import Task, TaskError, default_workers, map_tasks, single_threaded
from lab.compute.conftest import WORK

STOPPED = """
import signal
import sys
from pathlib import Path
import work
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by what a shell starts in the background
from epiprior_lab.compute.tasks import Task, map_tasks
tasks = [Task(name=str(i), payload={"value": i, "log": sys.argv[2]}) for i in range(60)]
map_tasks(work.slow, tasks, workers=2, description="slow", store=Path(sys.argv[1]))
"""

OWN_FUNCTION = """
from dataclasses import dataclass
from epiprior_lab.compute.tasks import Task, map_tasks

@dataclass(frozen=True)
class Number:
    value: int

def twice(number):
    return 2 * number.value

tasks = [Task(name=str(i), payload={"number": Number(i)}) for i in range(4)]
for workers in (1, 2):
    assert map_tasks(twice, tasks, workers=workers, description="own") == [0, 2, 4, 6]
"""


def tasks_of(name, values, **payload):
    return [Task(name=f"pair {value}", payload={name: value} | payload) for value in values]


@pytest.fixture
def doubled(work, tmp_path):
    """Double values through one store, and tell which of them were computed."""
    log = tmp_path / "log"

    def doubled(values, *, workers=1, **options):
        log.write_text("")
        how = {"workers": workers, "description": "doubling", "store": tmp_path / "store"}
        results = map_tasks(work.double, tasks_of("value", values, log=log), **how, **options)
        return results, sorted(int(line) for line in log.read_text().split())

    return doubled


@pytest.mark.parametrize("workers", [1, 2])
def test_results_keep_the_order_of_the_tasks_and_the_callers_arrays_stay(work, workers, tmp_path):
    tasks = tasks_of("value", (5, 1, 4, 2))
    assert map_tasks(work.double, tasks, workers=workers, description="doubling") == [10, 2, 8, 4]
    assert map_tasks(work.double, [], workers=workers, description="nothing", store=tmp_path / "store") == []
    arrays = [np.zeros(300_000) for _ in range(2)]
    tasks = [Task(name=str(i), payload={"array": array}) for i, array in enumerate(arrays)]
    results = map_tasks(work.fill, tasks, workers=workers, description="fill")
    assert all((result == 7).all() for result in results)
    assert all((array == 0).all() for array in arrays)


def test_stored_results_are_used_again_and_the_store_does_not_grow_with_new_keys(doubled, change, tmp_path):
    assert doubled([1, 2]) == ([2, 4], [1, 2])
    assert doubled([3, 2, 1]) == ([6, 4, 2], [3])
    change(f'"""About."""\n{WORK}# a comment\n')
    assert doubled([1, 2])[1] == []  # what is said of the code determines no result
    change(WORK + "CHANGED = True\n")
    assert doubled([1, 2, 3])[1] == [1, 2, 3]  # other code is another key
    assert len(list((tmp_path / "store").iterdir())) == 3


def test_payload_files_and_code_enter_the_key(work, change, tmp_path):
    path = tmp_path / "input.txt"
    task, blind = (Task(name="only", payload={"path": path}, files=files) for files in ((path,), ()))
    for text, which, expected in (("1", task, "1"), ("2", task, "2"), ("3", blind, "3"), ("4", blind, "3")):
        path.write_text(text)
        how = {"workers": 1, "description": "read", "store": tmp_path / "store"}
        assert map_tasks(work.read, [which], **how) == [expected]
    change(WORK + "CHANGED = True\n")
    assert map_tasks(work.read, [blind], **how) == ["4"]


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b[:-1] + b"?", lambda b: b""])
def test_a_damaged_result_is_computed_again(doubled, tmp_path, damage):
    doubled([1, 2])
    victim = next((tmp_path / "store").glob("pair_2-*"))
    victim.write_bytes(damage(victim.read_bytes()))
    assert doubled([1, 2]) == ([2, 4], [2])


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_even_one_that_cannot_be_pickled_names_the_task_and_keeps_what_was_ready(doubled, workers, work):
    with pytest.raises(TaskError, match=r"doubling: task 'pair -1' failed: ValueError: -1 is negative"):
        doubled([1, 2, 3, 4, 5, 6, 7, -1], workers=workers)
    assert doubled([1, 2, 3, 4], workers=workers) == ([2, 4, 6, 8], [])
    tasks = [Task(name=name) for name in "ab"]
    with pytest.raises(TaskError, match="odd: task 'a' failed: Odd: one and two"):
        map_tasks(work.raise_odd, tasks, workers=workers, description="odd")


@pytest.mark.parametrize("workers", [1, 2])
def test_the_first_failure_is_named_and_nothing_is_started_after_it(work, tmp_path, workers):
    log, store = tmp_path / "log", tmp_path / "store"
    values = [0, 3, 5, *range(6, 46, 2)]
    seconds = {3: 0.5}  # 5 fails before 3 does
    tasks = [Task(name=str(v), payload={"seconds": seconds.get(v, 0.1), "log": log, "value": v}) for v in values]
    with pytest.raises(TaskError, match="odd or even: task '3' failed: ValueError: 3 is odd"):
        map_tasks(work.fail_after, tasks, workers=workers, description="odd or even", store=store)
    started = [int(line) for line in log.read_text().split()]
    assert len(started) < 12
    names = {path.name.split("-")[0] for path in store.iterdir()}
    assert names == {str(v) for v in started} - {"3", "5"}  # what had been handed out was let end


def test_an_interrupt_goes_through_and_a_killed_worker_is_told_and_what_was_ready_is_kept(work, tmp_path):
    store = tmp_path / "store"
    tasks = tasks_of("value", range(12))
    with pytest.raises(TaskError, match=r"die: task 'pair 5': its worker was killed"):
        map_tasks(work.die, tasks, workers=2, description="die", store=store)
    assert list(store.glob("pair_0-*"))
    assert map_tasks(work.die, tasks[:5], workers=2, description="die", store=store) == list(range(5))
    with pytest.raises(KeyboardInterrupt):
        map_tasks(work.interrupt, tasks_of("value", range(4)), workers=1, description="interrupt", store=tmp_path)
    assert len(list(tmp_path.glob("*.result"))) == 2


def test_functions_and_payloads_of_a_script(tmp_path):
    (tmp_path / "script.py").write_text(OWN_FUNCTION, encoding="utf-8")
    subprocess.run([sys.executable, tmp_path / "script.py"], check=True, capture_output=True, timeout=120)


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_run_leaves_no_workers_and_continues(work, tmp_path, stop):
    script, store, log = tmp_path / "stopped.py", tmp_path / "store", tmp_path / "log"
    script.write_text(STOPPED, encoding="utf-8")
    command = [sys.executable, str(script), str(store), str(log)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True) as run:
        try:
            deadline = time.monotonic() + 120
            while len(list(store.glob("*.result"))) < 10 and time.monotonic() < deadline:
                time.sleep(0.01)
            workers = psutil.Process(run.pid).children()
            assert len(workers) >= 2
            if stop == signal.SIGKILL:
                run.kill()  # this process only: its workers have to notice
            else:
                os.killpg(run.pid, stop)  # as a terminal does: workers get it too
            _, told = run.communicate(timeout=60)
            assert psutil.wait_procs(workers, timeout=60)[1] == []
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)
    assert (run.returncode, told.count(b"KeyboardInterrupt")) == (-stop, stop == signal.SIGINT)
    before = {path.name for path in store.glob("*.result")}
    assert 10 <= len(before) < 60
    log.write_text("")
    tasks = [Task(name=str(i), payload={"value": i, "log": str(log)}) for i in range(60)]
    options = {"workers": 2, "description": "slow", "store": store}
    assert map_tasks(work.slow, tasks, **options) == [2 * i for i in range(60)]
    assert len(log.read_text().split()) == 60 - len(before)


def test_one_and_two_workers_give_the_same_bytes(work, tmp_path):
    stored = []
    for workers in (1, 2):
        how = {"workers": workers, "description": "products", "store": tmp_path / f"{workers}"}
        map_tasks(work.product, tasks_of("seed", range(6)), **how)
        stored.append({path.name: path.read_bytes() for path in how["store"].iterdir()})
    assert len(stored[0]) == 6
    assert stored[0] == stored[1]


def test_tasks_see_one_thread_and_the_caller_gets_its_threads_and_environment_back(work, monkeypatch):
    before = cv2.getNumThreads(), numba.get_num_threads()
    tasks = [Task(name=str(i)) for i in range(6)]
    alone = map_tasks(work.threads, tasks, workers=1, description="threads")
    assert {tuple(row) for row in alone} == {(os.getpid(), 1, 1, 1)}
    spread = map_tasks(work.threads, tasks, workers=2, description="threads")
    assert os.getpid() not in {row[0] for row in spread}
    assert {tuple(row[1:]) for row in spread} == {(1, 1, 1)}
    assert (cv2.getNumThreads(), numba.get_num_threads()) == before
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with single_threaded():
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
        assert all(pool["num_threads"] == 1 for pool in threadpoolctl.threadpool_info())
    assert (os.environ["OMP_NUM_THREADS"], os.environ.get("MKL_NUM_THREADS")) == ("3", None)


@dataclass(frozen=True)
class Options:
    low: float
    high: float


def test_equal_payloads_have_equal_keys_and_others_differ(work):
    keys = ResultStore(work.double)
    values = [1, 1.0, True, "1", [1, [2]], [[1], 2], (1, 2), ["1", "2"], ["12"], np.float64(1), np.zeros(4)]
    values += [np.zeros((2, 2)), np.zeros(4, np.float32), Options(0, 1), Options(1, 0), None, b"1", Path("1")]
    payloads = [{}, *({"a": value} for value in values)]
    assert len({keys.key(payload, ()) for payload in payloads}) == len(payloads)
    assert keys.key({"a": 1, "b": [np.ones(2)]}, ()) == keys.key({"b": [np.ones(2)], "a": 1}, ())


def test_bad_calls_and_workers_with_other_code_are_named(work, tmp_path):
    call = cloudpickle.dumps((work.double, {"value": 1}))
    assert pickle.loads(parallel._run(call, "doubling", Path.cwd(), installation())) == 2
    with pytest.raises(TaskError, match=rf"doubling failed: .*worker {os.getpid()} on \S+ has other code"):
        parallel._run(call, "doubling", Path.cwd(), b"other")
    a, unstable = Task(name="a"), Task(name="a", payload={"value": object()})
    for tasks, workers, error, message in (
        ([a], 0, SettingsError, "workers = 0"),
        ([a, a], 1, SettingsError, "repeated task name 'a'"),
        ([unstable], 1, SettingsError, "task 'a': payload: object has no stable key"),
        ([replace(a, files=(tmp_path / "absent.jpg",))], 1, TaskError, r"task 'a': cannot read .*absent\.jpg"),
    ):
        with pytest.raises(error, match=message):
            map_tasks(work.double, tasks, workers=workers, description="doubling", store=tmp_path / "store")


def test_workers_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("EPIPRIOR_WORKERS", "3")
    assert default_workers() == 3
    monkeypatch.delenv("EPIPRIOR_WORKERS")
    assert default_workers() >= 1
    for text in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv("EPIPRIOR_WORKERS", text)
        with pytest.raises(SettingsError, match=f"EPIPRIOR_WORKERS = '{text}'"):
            default_workers()


def test_progress_without_a_terminal_is_lines(work, capsys, monkeypatch):
    monkeypatch.setattr(parallel, "_SECONDS_BETWEEN_LINES", 0.0)
    map_tasks(work.double, tasks_of("value", range(3)), workers=1, description="doubling")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" after")[0] for line in lines] == [f"doubling: {i} of 3" for i in (1, 2, 3, 3)]
