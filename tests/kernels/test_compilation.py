"""Compiling is announced, kept on disk, and does without a disk."""

import logging

from command_line import run_python
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
        for kernel, what in [(Fresh, "this"), (Compiled, "that"), (Broken, "those")] * 2:
            compilation.announce_compilation(kernel, what, "a second")
    line = "compiling kernels of {}: the first call on this machine takes a second"
    assert [record.message for record in caplog.records] == [line.format("this"), line.format("those")]


WALK = """
import logging; logging.basicConfig(level=logging.INFO)
from epiprior.kernels import compilation, one_to_one
compilation.announce_compilation(one_to_one._walk, 'the walk', 'a second')
assert one_to_one.one_to_one_mask([0, 0, 1], [3, 4, 4]).tolist() == [True, False, True]
"""


NOWHERE = """
from numba.core import caching
def refuse(self):
    raise PermissionError(13, "Permission denied")
caching._CacheLocator.ensure_cache_path = refuse
"""


def test_the_cache_of_compiled_kernels_is_recognised_and_not_needed(tmp_path):
    """The second process finds what the first one compiled, and says nothing."""
    said = [run_python(WALK, NUMBA_CACHE_DIR=str(tmp_path)).stderr for _ in range(2)]
    assert "compiling kernels" in said[0]
    assert "compiling kernels" not in said[1]
    # As in an install that is read-only, with a home that is not writable: a warning, once for all kernels.
    said = run_python(NOWHERE + WALK).stderr
    assert said.count("no folder for compiled kernels can be written") == 1
    assert "compiling kernels of the walk" in said


def test_a_damaged_cache_of_compiled_kernels_is_made_anew(tmp_path):
    run_python(WALK, NUMBA_CACHE_DIR=str(tmp_path))
    for suffix in ("nbi", "nbc"):
        for file in tmp_path.rglob(f"*.{suffix}"):
            file.write_bytes(b"\x80\x05\x8c\x04\xff\xff\xff\xff" if suffix == "nbi" else file.read_bytes()[:-100])
        said = [run_python(WALK, NUMBA_CACHE_DIR=str(tmp_path)).stderr for _ in range(2)]
        assert "damaged cache of the compiled kernel" in said[0], suffix
        assert "damaged" not in said[1]
        assert "compiling" not in said[1]
