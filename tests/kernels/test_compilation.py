"""Compiling is announced, kept on disk, and does without a disk."""

from command_line import run_python

WALK = """
import logging; logging.basicConfig(level=logging.INFO)
from epiprior.kernels import one_to_one
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
    assert said[0].count("compiling kernels") == 1
    assert "compiling kernels" not in said[1]
    # As in an install that is read-only, with a home that is not writable: a warning, once for all kernels.
    said = run_python(NOWHERE + WALK).stderr
    assert said.count("no folder for compiled kernels can be written") == 1


def test_a_damaged_cache_of_compiled_kernels_is_made_anew(tmp_path):
    run_python(WALK, NUMBA_CACHE_DIR=str(tmp_path))
    for suffix in ("nbi", "nbc"):
        for file in tmp_path.rglob(f"*.{suffix}"):
            file.write_bytes(b"\x80\x05\x8c\x04\xff\xff\xff\xff" if suffix == "nbi" else file.read_bytes()[:-100])
        said = [run_python(WALK, NUMBA_CACHE_DIR=str(tmp_path)).stderr for _ in range(2)]
        assert "damaged cache of the compiled kernel" in said[0], suffix
        assert "damaged" not in said[1]
        assert "compiling" not in said[1]
