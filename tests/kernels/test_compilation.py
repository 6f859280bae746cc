"""The announcement that kernels are compiled."""

import logging
import os
import subprocess
import sys

import pytest

from epiprior.kernels import compilation
from synthetic import make_pair


def test_compilation_is_announced_once_per_kernel(monkeypatch, caplog):
    class Fresh:
        signatures = ()
        py_func = make_pair

        class stats:  # noqa: N801
            cache_path = "no such folder"

    class Compiled(Fresh):
        signatures = ("float64()",)

    class Broken:
        signatures = ()

    monkeypatch.setattr(compilation, "_asked", set())
    with caplog.at_level(logging.INFO, logger="epiprior"):
        for _ in range(2):
            compilation.announce_compilation(Fresh, "this", "a second")
            compilation.announce_compilation(Compiled, "that", "a second")
            compilation.announce_compilation(Broken, "those", "a second")
    line = "compiling kernels of {}: the first call on this machine takes a second"
    assert [record.message for record in caplog.records] == [line.format("this"), line.format("those")]


@pytest.mark.parametrize("name", ["epiprior", "beem", "usac"])
def test_own_estimators_announce_their_kernels(monkeypatch, name):
    from epiprior.estimators import epiprior as starting_from_votes
    from epiprior.estimators import own, run

    said = []
    for module in (starting_from_votes, own):
        monkeypatch.setattr(module, "announce_compilation", lambda kernel, *words: said.append(kernel))
    run(name, make_pair().matches)
    assert said == {"epiprior": [starting_from_votes.climb], "beem": [own.run_loop], "usac": []}[name]


def test_the_cache_of_compiled_kernels_is_recognised(tmp_path):
    # The second process finds what the first one compiled, and says nothing.
    code = (
        "import logging, numpy as np; logging.basicConfig(level=logging.INFO)\n"
        "from epiprior.kernels import compilation\n"
        "from epiprior.ranking import votes\n"
        "compilation.announce_compilation(votes.add_votes, 'the votes', 'a second')\n"
        "votes.count_votes(np.ones((1, 3, 3)), np.ones((1, 2)), np.ones((1, 2)))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment).stderr
        for _ in range(2)
    ]
    assert "compiling kernels" in said[0]
    assert "compiling kernels" not in said[1]
