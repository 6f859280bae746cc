"""A module with functions for tasks, which every worker that is started from now on can import."""

import os
import sys
from pathlib import Path

import pytest

from epiprior_lab.compute.source_graph import source_files

WORK = """
import os, sys, time
from pathlib import Path
import cv2, numba, numpy as np, threadpoolctl

FACTOR = 2

def double(value, log=None):
    if log is not None:
        with Path(log).open("a") as file:
            file.write(f"{value}\\n")
    if value < 0:
        raise ValueError(f"{value} is negative")
    return FACTOR * value

def slow(value, log):
    time.sleep(0.05)
    return double(value, log)

def threads(seconds=0):
    time.sleep(seconds)
    pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
    return [os.getpid(), cv2.getNumThreads(), numba.get_num_threads(), max(pools, default=1)]

def product(seed):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(300, 300)).astype(np.float32)
    return {"rows": rows @ rows.T, "name": sys.intern("rows"), "again": "rows"}

def describe(path):
    time.sleep(0.05)
    _, descriptors = cv2.SIFT_create().detectAndCompute(cv2.imread(path, cv2.IMREAD_GRAYSCALE), None)
    return np.linalg.svd(descriptors, compute_uv=False)

def read(path):
    return Path(path).read_text()

def fill(array):
    array[:] = 7
    return array

def fail_after(seconds, value, log=None):
    double(value, log)
    time.sleep(seconds)
    if value % 2:
        raise ValueError(f"{value} is odd")
    return os.getcwd()

class Odd(Exception):
    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")

def raise_odd():
    raise Odd("one", "two")

def die(value):
    if value == 5:
        os.kill(os.getpid(), 9)
    return value

def interrupt(value):
    if value == 2:
        raise KeyboardInterrupt
    return value
"""


@pytest.fixture(scope="module")
def work_module(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    (folder / "work.py").write_text(WORK, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        patch.delenv("EPIPRIOR_SCHEDULER", raising=False)
        import work

        yield work
    del sys.modules["work"]


@pytest.fixture
def work(work_module):
    yield work_module
    Path(work_module.__file__).write_text(WORK, encoding="utf-8")
    source_files.cache_clear()


@pytest.fixture
def change(work):

    def change(text):
        Path(work.__file__).write_text(text, encoding="utf-8")
        source_files.cache_clear()

    return change
