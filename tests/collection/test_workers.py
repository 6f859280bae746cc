"""Processes beside this one: what they return, what is told of those that fail, and that none is left behind."""

import math
import os
import signal
import subprocess
import sys
import time

import pytest

from epiprior import ImageError, SettingsError
from epiprior.collection.workers import WorkerError, open_pool, run_tasks
from epiprior.features.images import load_photograph


def test_results_and_errors_killed_workers_and_other_installations_are_told(tmp_path, monkeypatch):
    numbers = range(30)
    with open_pool(2) as pool:
        found = dict(run_tasks(pool, math.factorial, ((n, (n,)) for n in numbers)))
    assert found == {n: math.factorial(n) for n in numbers}
    with open_pool(1) as pool:
        with pytest.raises(ImageError, match=r"gone\.png: no such image file"):
            list(run_tasks(pool, load_photograph, [(1, (tmp_path / "gone.png",))]))
        with pytest.raises(WorkerError, match=r"(?s)ValueError.*Traceback"):
            list(run_tasks(pool, math.sqrt, [(1, (-1.0,))]))
        assert list(run_tasks(pool, math.sqrt, [(1, (4.0,))])) == [(1, 2.0)]
    with open_pool(1) as pool, pytest.raises(WorkerError, match="a worker was killed"):
        list(run_tasks(pool, os._exit, [(1, (1,))]))
    monkeypatch.setattr("epiprior.collection.workers.installation", lambda: "mine")
    with open_pool(1) as pool, pytest.raises(SettingsError, match="has another epiprior"):
        list(run_tasks(pool, math.sqrt, [(1, (4.0,))]))


def test_workers_end_with_a_killed_parent():
    program = (
        "import os, time\n"
        "from epiprior.collection.workers import open_pool, run_tasks\n"
        "with open_pool(1) as pool:\n"
        "    print(dict(run_tasks(pool, os.getpid, [(1, ())]))[1], flush=True)\n"
        "    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as parent:
        worker = int(parent.stdout.readline())
        os.kill(worker, 0)
        parent.send_signal(signal.SIGKILL)
    for _ in range(100):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("the worker lives on")


def test_what_cannot_be_opened():
    with pytest.raises(SettingsError, match="workers = 0"), open_pool(0):
        pass
    pytest.importorskip("distributed")
    with pytest.raises(SettingsError, match="no dask scheduler answers"), open_pool(scheduler="tcp://127.0.0.1:9"):
        pass
