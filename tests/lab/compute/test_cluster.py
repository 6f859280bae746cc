"""Tasks on a cluster: a scheduler and two workers, each a process of its own on this machine."""

import contextlib
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior_lab.compute.tasks import Task, TaskError, map_tasks
from pictures import relief_pair, save

TASKS = 20
pytestmark = pytest.mark.slow


class Cluster:
    """A scheduler and its workers; `ensure` starts what is missing."""

    def __init__(self, folder):
        self.folder = folder
        self.scheduler = None
        self.address = None
        self.workers = []

    def ensure(self, workers):
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.close()
            file = self.folder / "scheduler.json"
            file.unlink(missing_ok=True)
            self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", file)
            wait_until(lambda: file.exists() and file.read_text().endswith("}"))
            self.address = json.loads(file.read_text())["address"]
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        while len(self.workers) < workers:
            options = ["--no-nanny", "--nthreads", "2", "--death-timeout", "30", "--local-directory", self.folder]
            self.workers.append(self._start("worker", self.address, *options))

    def _start(self, kind, *options):
        module = f"distributed.cli.dask_{kind}"
        command = [sys.executable, "-m", module, *map(str, options), "--host", "127.0.0.1", "--no-dashboard"]
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log)

    def close(self):
        for process in (*self.workers, *filter(None, [self.scheduler])):
            process.kill()
            process.wait()
        self.workers = []


def wait_until(condition, seconds=300):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextlib.contextmanager
def killed(process, store, results):
    """Kill a process as soon as so many results are stored; yield a list that gets their number."""
    found, ended = [], []

    def kill():
        wait_until(lambda: ended or len(list(store.glob("*.result"))) >= results)
        process.kill()
        found.append(len(list(store.glob("*.result"))))

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        yield found
    finally:
        ended.append(True)
        killer.join()


@pytest.fixture(scope="module")
def cluster(work_module, tmp_path_factory):
    with contextlib.closing(Cluster(tmp_path_factory.mktemp("cluster"))) as cluster:
        yield cluster


@pytest.fixture(autouse=True)
def no_client_left():
    """Assert that no thread of a client outlives a test: when it is collected later, it may block another one."""
    yield
    assert "IO loop" not in {thread.name for thread in threading.enumerate()}


def test_a_cluster_that_loses_a_worker_gives_the_same_bytes(cluster, work, tmp_path, monkeypatch):
    cluster.ensure(workers=2)
    paths = [save(tmp_path / f"{k}.png", relief_pair(160, 120, seed=k)[0]) for k in range(TASKS)]
    tasks = [Task(name=path.name, payload={"path": str(path)}, files=(path,)) for path in paths]

    def run(name):
        map_tasks(work.describe, tasks, workers=1, description=name, store=tmp_path / name)
        return {path.name: path.read_bytes() for path in (tmp_path / name).glob("*.result")}

    alone = run("alone")
    assert len(alone) == TASKS
    monkeypatch.setenv("EPIPRIOR_SCHEDULER", cluster.address)
    with killed(cluster.workers[0], tmp_path / "cluster", 3) as at_kill:
        assert run("cluster") == alone
    assert at_kill[0] < TASKS
    assert cluster.workers[0].wait(timeout=10) != 0


def test_tasks_of_a_cluster_have_one_thread_each_and_their_own_arrays(cluster, work, monkeypatch):
    cluster.ensure(workers=1)
    monkeypatch.setenv("EPIPRIOR_SCHEDULER", cluster.address)
    tasks = [Task(name=str(i), payload={"seconds": 0.2}) for i in range(8)]
    rows = map_tasks(work.threads, tasks, workers=1, description="threads")
    assert {row[0] for row in rows} <= {worker.pid for worker in cluster.workers}
    assert {tuple(row[1:]) for row in rows} == {(1, 1, 1)}
    arrays = [np.zeros(2_000_000), np.zeros(10)]  # the first is so large that dask would warn
    tasks = [Task(name=str(i), payload={"array": array}) for i, array in enumerate(arrays)]
    filled = map_tasks(work.fill, tasks, workers=1, description="fill")
    assert all((array == 7).all() for array in filled)
    assert all((array == 0).all() for array in arrays)


def test_the_first_failure_on_a_cluster_is_named(cluster, work, tmp_path, monkeypatch):
    cluster.ensure(workers=1)
    monkeypatch.setenv("EPIPRIOR_SCHEDULER", cluster.address)
    values = [0, 3, 5, *range(6, 26, 2)]
    tasks = [Task(name=str(v), payload={"seconds": 0.5 if v == 3 else 0.05, "value": v}) for v in values]
    store = tmp_path / "store"
    with pytest.raises(TaskError, match="odd or even: task '3' failed: ValueError: 3 is odd"):
        map_tasks(work.fail_after, tasks, description="odd or even", store=store)
    assert 1 <= len(list(store.iterdir())) < len(tasks) - 2
    folder = map_tasks(work.fail_after, tasks[:1], description="folder")
    assert folder == [str(Path.cwd())]  # not the folder that the worker was started in


def test_a_lost_scheduler_is_told_and_what_was_ready_is_kept(cluster, work, tmp_path, monkeypatch):
    cluster.ensure(workers=1)
    monkeypatch.setenv("EPIPRIOR_SCHEDULER", cluster.address)
    tasks = [Task(name=f"pair {v}", payload={"seconds": 0.1, "value": 2 * v}) for v in range(200)]
    store = tmp_path / "store"
    with killed(cluster.scheduler, store, 5), pytest.raises(TaskError, match="scheduler was lost"):
        map_tasks(work.fail_after, tasks, description="work", store=store)
    assert 5 <= len(list(store.glob("*.result"))) < 200


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", "tcp://127.0.0.1:port"])
def test_an_address_without_a_scheduler_and_a_missing_package_are_named(work, monkeypatch, address):
    monkeypatch.setattr("epiprior.collection.workers._SECONDS_TO_CONNECT", 0.5)
    monkeypatch.setenv("EPIPRIOR_SCHEDULER", address)
    tasks, how = [Task(name="a", payload={"seconds": 0})], {"workers": 1, "description": "threads"}
    with pytest.raises(SettingsError, match=f"scheduler = '{address}': no dask scheduler answers"):
        map_tasks(work.threads, tasks, **how)
    assert map_tasks(work.threads, [], **how) == []
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SettingsError, match=r"epiprior\[cluster\]"):
        map_tasks(work.threads, tasks, **how)
